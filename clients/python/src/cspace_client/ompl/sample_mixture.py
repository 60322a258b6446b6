"""Which state a planner draws next: the goal, a learned sample, or a uniform one."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cspace_client.models import Joints

Sample = TypeVar("Sample")

_BLOCK = 256


class StateDraws(Protocol):
    """A source of states for a planner, which counts what it gave."""

    goal_drawn: int
    learned_drawn: int
    uniform_drawn: int
    state_checks: int

    def draw(self) -> Sequence[float]:
        """The next configuration, d values in rad."""
        ...

    def goal_reached(self) -> None:
        """The tree has reached the goal."""
        ...


class GoalOnly:
    """Gives the goal; for planners that draw uniform states themselves."""

    def __init__(self, goal: Sequence[float]) -> None:
        self.goal_drawn = self.learned_drawn = self.uniform_drawn = self.state_checks = 0
        self._goal = goal

    def draw(self) -> Sequence[float]:
        """The goal."""
        self.goal_drawn += 1
        return self._goal

    def goal_reached(self) -> None:
        """Nothing changes: OMPL itself stops drawing the goal."""


class SampleMixture:
    """Draws the goal by its bias, else a learned sample or, by their share, a uniform one.

    The learned samples come in the order given and once each, as ``BiasSampler[i]`` in algorithm 3 of the
    MultiWGAN-GP paper; after the last one all further states are uniform.

    Args:
        space: the joint space.
        goal: d values in rad.
        samples: (n, d) learned samples, rad; wrapped here.
        goal_bias: share of the goal, 0 to 1.
        uniform_share: share of uniform samples among the others while learned ones are left, 0 to 1.
        rng: the random generator.
        is_free: checks a configuration of d values in rad. Learned samples that it rejects are put off until
            all others are drawn. None checks nothing.
    """

    def __init__(
        self,
        space: Joints,
        goal: Sequence[float],
        samples: NDArray[np.float64],
        goal_bias: float,
        uniform_share: float,
        rng: np.random.Generator,
        is_free: Callable[[Sequence[float]], bool] | None = None,
    ) -> None:
        self.goal_drawn = self.learned_drawn = self.uniform_drawn = self.state_checks = 0
        self._space, self._rng = space, rng
        self._goal, self._goal_bias = goal, goal_bias
        wrapped: list[list[float]] = space.wrap(samples).tolist()
        self._count = len(wrapped)
        self._samples = iter(wrapped) if is_free is None else free_first(wrapped, self._counted(is_free))
        self._uniform_share = uniform_share
        # Drawn in blocks: one call of numpy for each state would cost more than checking its edge.
        self._choices: list[list[float]] = []
        self._uniform: list[list[float]] = []

    def draw(self) -> Sequence[float]:
        """The next configuration, d values in rad."""
        if not self._choices:
            self._choices = self._rng.random((_BLOCK, 2)).tolist()
        for_goal, for_uniform = self._choices.pop()
        if for_goal < self._goal_bias:
            self.goal_drawn += 1
            return self._goal
        if self.learned_drawn < self._count and for_uniform >= self._uniform_share:
            self.learned_drawn += 1
            return next(self._samples)
        return self._draw_uniform()

    def goal_reached(self) -> None:
        """No goal is drawn from now on, as in OMPL's own RRT* with a single goal state."""
        self._goal_bias = 0.0

    def _counted(self, is_free: Callable[[Sequence[float]], bool]) -> Callable[[Sequence[float]], bool]:
        def counted(sample: Sequence[float]) -> bool:
            self.state_checks += 1
            return is_free(sample)

        return counted

    def _draw_uniform(self) -> Sequence[float]:
        if not self._uniform:
            self._uniform = self._space.sample_uniform(self._rng, _BLOCK).tolist()
        self.uniform_drawn += 1
        return self._uniform.pop()


def free_first(samples: Iterable[Sample], is_free: Callable[[Sample], bool]) -> Iterator[Sample]:
    """Samples with those that collide after all others, each looked at as its turn comes.

    They may still lead towards a passage, so none is dropped.

    Args:
        samples: in the order that is kept else.
        is_free: tells whether one does not collide.
    """
    put_off = []
    for sample in samples:
        if is_free(sample):
            yield sample
        else:
            put_off.append(sample)
    yield from put_off
