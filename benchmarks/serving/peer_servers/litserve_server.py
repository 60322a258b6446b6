"""The bundle behind LitServe."""

import os

import litserve
from common import Model


class Sampler(litserve.LitAPI):
    def setup(self, device):
        del device
        self.model = Model()

    def decode_request(self, request):
        return request["image"], request["n"], request["seed"]

    def predict(self, x):
        return self.model.answer(*x)

    def encode_response(self, output):
        return output


if __name__ == "__main__":
    # Requests go to the worker by ZeroMQ instead of a queue of a manager's process.
    server = litserve.LitServer(
        Sampler(api_path="/sample"), accelerator="cpu", workers_per_device=1, fast_queue=True
    )
    server.run(
        host="127.0.0.1",
        port=int(os.environ["CSPACE_PEER_PORT"]),
        generate_client_file=False,
        log_level="warning",
    )
