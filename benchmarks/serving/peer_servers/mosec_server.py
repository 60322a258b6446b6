"""The bundle behind mosec: a server in Rust, and a worker in Python behind a socket."""

from common import Model
from mosec import Server, Worker


class Sampler(Worker):
    def __init__(self) -> None:
        super().__init__()
        self.model = Model()

    def forward(self, data: dict) -> dict:
        return self.model.answer(data["image"], data["n"], data["seed"])


if __name__ == "__main__":
    server = Server()
    # A batch of one: the graphs take one picture at a time, so that waiting for a second one gains nothing.
    server.append_worker(Sampler, num=1, max_batch_size=1, route="/sample")
    server.run()
