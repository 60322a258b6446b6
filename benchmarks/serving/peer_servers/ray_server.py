"""The bundle behind Ray Serve."""

import os
import signal
import sys
import time

import ray
from common import Model
from ray import serve


@serve.deployment(num_replicas=1, max_ongoing_requests=64)
class Sampler:
    def __init__(self) -> None:
        self.model = Model()

    async def __call__(self, request):
        body = await request.json()
        return self.model.answer(body["image"], body["n"], body["seed"])


if __name__ == "__main__":
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    serve.start(http_options={"host": "127.0.0.1", "port": int(os.environ["CSPACE_PEER_PORT"])})
    serve.run(Sampler.bind(), name="sampler", route_prefix="/sample")
    # HAProxy is a daemon of its own, which only Serve's own end takes with it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        while True:
            time.sleep(60)
    finally:
        serve.shutdown()
        ray.shutdown()
