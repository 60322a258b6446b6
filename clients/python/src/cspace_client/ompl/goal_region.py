"""The one place where Python can hand states to OMPL's RRT and RRT*: their goal.

OMPL's Python binding has no way to replace a planner's state sampler. Its planners ask a sampleable goal for
states, though, with a probability (the goal bias) that may be 1. So the learned samples, the uniform ones and
the goal itself all come through ``sampleGoal``; what counts as reached is still the real goal alone.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from ompl import base as ob

from cspace_client.joint_space import Joints
from cspace_client.ompl.sample_mixture import StateDraws
from cspace_client.ompl.state_space import StateAccess

REACHED_RAD = 1e-9
_UNLIMITED = 2**31 - 1


class DrawnGoal(ob.GoalSampleableRegion):  # type: ignore[misc]
    """A goal whose states come from a source of draws.

    Args:
        information: OMPL's space information.
        space: the joint space.
        goal: d values in rad; the distance is to this one.
        draws: what ``sampleGoal`` gives.
        unlimited: whether the source has more than the goal to give. If not, OMPL treats the region as it
            treats a single goal state.
    """

    def __init__(
        self,
        information: Any,
        space: Joints,
        goal: Sequence[float],
        draws: StateDraws,
        *,
        unlimited: bool,
    ) -> None:
        super().__init__(information)
        self.setThreshold(REACHED_RAD)
        self._access = StateAccess(space)
        self._goal = [float(value) for value in goal]
        self._periodic = space.periodic
        self._draws = draws
        self._limit = _UNLIMITED if unlimited else 1
        self._buffer = np.empty(space.dim)

    def distanceGoal(self, state: Any) -> float:  # noqa: N802 - OMPL's name
        """OMPL's distance to the real goal, rad."""
        self._access.read(state, self._buffer)
        total = 0.0
        for value, goal, periodic in zip(self._buffer.tolist(), self._goal, self._periodic, strict=True):
            gap = abs(value - goal)
            total += min(gap, abs(math.tau - gap)) if periodic else gap
        if total < REACHED_RAD:
            self._draws.goal_reached()
        return total

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        """The next state of the source."""
        self._access.write(state, self._draws.draw())

    def maxSampleCount(self) -> int:  # noqa: N802
        """How many states may be asked for."""
        return self._limit

    def couldSample(self) -> bool:  # noqa: N802
        """Always."""
        return True
