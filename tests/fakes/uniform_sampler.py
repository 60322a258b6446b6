"""Uniform configurations as a source of samples: the baseline that looks at no picture."""

import numpy as np

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
