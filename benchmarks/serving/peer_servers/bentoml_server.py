"""The bundle behind BentoML."""

import bentoml
from common import Model


@bentoml.service(workers=1, traffic={"timeout": 60})
class Sampler:
    def __init__(self) -> None:
        self.model = Model()

    @bentoml.api
    def sample(self, image: str, n: int = 300, seed: int = 0) -> dict:
        return self.model.answer(image, n, seed)
