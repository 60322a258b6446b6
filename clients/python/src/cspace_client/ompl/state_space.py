"""A joint space as OMPL sees it, its states as floats, and a goal that hands states to its planners.

Every joint is a subspace of its own: SO(2) for a circle, a real interval for a limited one. OMPL's distance
is the sum over the joints.

OMPL's Python binding has no way to replace a planner's state sampler. Its planners ask a sampleable goal for
states, though, with a probability (the goal bias) that may be 1. So the learned samples, the uniform ones and
the goal itself all come through ``sampleGoal``; what counts as reached is still the real goal alone.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob

from cspace_client.errors import PlanningError
from cspace_client.models import Joints, JointSpace
from cspace_client.ompl.sample_mixture import StateDraws


def make_state_space(space: Joints) -> Any:
    """OMPL's product space of a joint space."""
    product = ob.CompoundStateSpace()
    for low, high, periodic in zip(space.lower, space.upper, space.periodic, strict=True):
        if periodic:
            product.addSubspace(ob.SO2StateSpace(), 1.0)
        else:
            interval = ob.RealVectorStateSpace(1)
            interval.setBounds(low, high)
            product.addSubspace(interval, 1.0)
    return product


class StateAccess:
    """Copies OMPL's states to floats and back; a state that a callback was given must not outlive it.

    Args:
        space: the joint space.
    """

    def __init__(self, space: Joints) -> None:
        self.dim = space.dim
        self._circles = [joint for joint in range(space.dim) if space.periodic[joint]]
        self._intervals = [joint for joint in range(space.dim) if not space.periodic[joint]]

    def read(self, state: Any, into: NDArray[np.float64]) -> None:
        """Copy a state into (d,) rad."""
        for joint in self._circles:
            into[joint] = state[joint].value
        for joint in self._intervals:
            into[joint] = state[joint][0]

    def write(self, state: Any, values: Sequence[float]) -> None:
        """Copy d values in rad into a state."""
        for joint in self._circles:
            state[joint].value = values[joint]
        for joint in self._intervals:
            state[joint][0] = values[joint]

    def rows(self, states: Sequence[Any]) -> NDArray[np.float64]:
        """Copies of states as (N, d) rad."""
        out = np.empty((len(states), self.dim))
        for row, state in zip(out, states, strict=True):
            self.read(state, row)
        return out


def read_joint_space(states: Any) -> JointSpace:
    """The joint space that an OMPL state space is: circles (SO2), real vector spaces, or a product of these.

    Raises:
        PlanningError: it holds another kind of space.
    """
    sides: list[tuple[float, float, bool]] = []
    for part in _parts(states):
        if isinstance(part, ob.SO2StateSpace):
            sides.append((-math.pi, math.pi, True))
        elif isinstance(part, ob.RealVectorStateSpace):
            bounds = part.getBounds()
            sides += [(low, high, False) for low, high in zip(bounds.low, bounds.high, strict=True)]
        else:
            raise PlanningError(
                "the state space is of another kind",
                expected="SO2, real vector spaces, or a product of these",
                got=type(part).__name__,
            )
    lower, upper, periodic = zip(*sides, strict=True)
    return JointSpace(lower, upper, periodic)


def read_configuration(states: Any, state: Any) -> list[float]:
    """A state of such a space as values in the order of its joints."""
    # The binding's copyToReals fills a copy of the list that it is given.
    compound = isinstance(states, ob.CompoundStateSpace)
    values: list[float] = []
    for index, part in enumerate(_parts(states)):
        piece = state[index] if compound else state
        circle = isinstance(part, ob.SO2StateSpace)
        values += [piece.value] if circle else [piece[axis] for axis in range(part.getDimension())]
    return values


def _parts(states: Any) -> list[Any]:
    return list(states.getSubspaces()) if isinstance(states, ob.CompoundStateSpace) else [states]


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
