"""The bundle behind BentoML."""

import bentoml
from common import Model


# Without what it does beside answering: a line for each request, and metrics.
@bentoml.service(
    workers=1, traffic={"timeout": 60}, logging={"access": {"enabled": False}}, metrics={"enabled": False}
)
class Sampler:
    def __init__(self) -> None:
        self.model = Model()

    @bentoml.api
    def sample(self, image: str, n: int = 300, seed: int = 0) -> dict:
        return self.model.answer(image, n, seed)
