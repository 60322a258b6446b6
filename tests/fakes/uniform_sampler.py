"""Uniform configurations as a source of samples: the baseline that looks at no picture."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.query import SampleQuery
from cspace.space import JointSpace
from services.planner.samples import Picture, SampleBatch, SampleSource

UNIFORM = "uniform"


class UniformSampler(SampleSource):
    """Draws from the whole joint space.

    Args:
        space: the joint space.
    """

    def __init__(self, space: JointSpace) -> None:
        self._space = space

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """``query.n`` uniform configurations; picture and model change nothing."""
        drawn = self._space.sample_uniform(np.random.default_rng(query.seed), query.n)
        samples = self._space.to_float32(drawn)
        return SampleBatch(samples, UNIFORM, 0, "", query.seed, shortfall=0, round_trip_s=0.0)


class ScoredUniformSampler(UniformSampler):
    """Uniform samples with a validity head, of which those pass that score enough.

    Args:
        space: the joint space.
        score: of configurations (n, d), each 0 to 1.
        threshold: that the head recommends.
    """

    def __init__(
        self, space: JointSpace, score: Callable[[NDArray[Any]], NDArray[Any]], threshold: float = 0.5
    ) -> None:
        super().__init__(space)
        self.score_of, self.threshold = score, threshold

    def score(self, image: NDArray[np.uint8], configurations: NDArray[Any]) -> NDArray[np.float32]:
        """What the head says of configurations; the picture changes nothing."""
        return self.score_of(configurations).astype(np.float32)

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """As above where nothing is filtered; else the first of four times as many that pass."""
        if not query.min_confidence:
            return super().answer(picture, query)
        batch = super().answer(picture, replace(query, n=4 * query.n))
        good = self.score_of(batch.samples) >= query.min_confidence
        samples = batch.samples[good][: query.n]
        return replace(batch, samples=samples, acceptance=float(good.mean()))
