"""What the optimising planners minimise: a path's length on the torus, L2 as everywhere in this project.

OMPL's own path length adds up the joints (L1), so many shortest ways of different L2 length are equal to it:
in an open scene RRT* with it ended 8 % above the shortest path and did not improve. OMPL's binding has no
state space with an L2 metric on a torus and ignores a metric that is written in Python, so nearest neighbours
and ranges stay L1. An objective can be written in Python; it costs 1 to 2 microseconds an edge that is
weighed, and with it an iteration of RRT* takes four to six times as long as with OMPL's own.

It is also the only way to give InformedRRT* and BIT* an estimate to search by. They refuse OMPL's path length
on a product of circles, and wrapped into a ``MultiOptimizationObjective``, which they accept, every estimate
is 0: the informed planners then know nothing.
"""

import math
from collections.abc import Sequence
from typing import Any

from ompl import base as ob

from cspace.space import JointSpace
from services.planner.settings import INFORMED_RRT_STAR, RRT_STAR

ANY_COST = 1e9


class TorusLength(ob.OptimizationObjective):  # type: ignore[misc]
    """Length of the straight wrapped segment between two states, rad.

    Args:
        information: OMPL's space information.
        space: the joint space.
    """

    def __init__(self, information: Any, space: JointSpace) -> None:
        super().__init__(information)
        self._circles = [joint for joint in range(space.dim) if space.periodic[joint]]
        self._intervals = [joint for joint in range(space.dim) if not space.periodic[joint]]

    def length_rad(self, start: Any, end: Any) -> float:
        """Torus distance (L2) of two states."""
        total = 0.0
        for joint in self._circles:
            gap = abs(start[joint].value - end[joint].value)
            if gap > math.pi:
                gap = math.tau - gap
            total += gap * gap
        for joint in self._intervals:
            total += (start[joint][0] - end[joint][0]) ** 2
        return math.sqrt(total)

    def stateCost(self, state: Any) -> Any:  # noqa: N802, ARG002 - OMPL's name and argument
        """Nothing: a state has no length."""
        return ob.Cost(0.0)

    def motionCost(self, start: Any, end: Any) -> Any:  # noqa: N802
        """The segment's length."""
        return ob.Cost(self.length_rad(start, end))

    def motionCostHeuristic(self, start: Any, end: Any) -> Any:  # noqa: N802
        """The same: no way is shorter than the straight one."""
        return ob.Cost(self.length_rad(start, end))


class TorusLengthByGoal(TorusLength):
    """The same for InformedRRT*, whose estimate of a state goes on to the goal.

    Its sampler rejects states by the estimate from the start plus the cost to go. The binding has no way to
    set a cost to go, and the sampler is the only one that asks for the estimate, so both go into that.

    Args:
        information: OMPL's space information.
        space: the joint space.
        goal: d values in rad.
    """

    def __init__(self, information: Any, space: JointSpace, goal: Sequence[float]) -> None:
        super().__init__(information, space)
        self._goal = [(g,) if not wraps else _Angle(g) for g, wraps in zip(goal, space.periodic, strict=True)]

    def motionCostHeuristic(self, start: Any, end: Any) -> Any:  # noqa: N802
        """Lower bound of a path from the start through a state to the goal."""
        return ob.Cost(self.length_rad(start, end) + self.length_rad(end, self._goal))


class _Angle:
    """A value as OMPL's circles hold it."""

    __slots__ = ("value",)

    def __init__(self, value: float) -> None:
        self.value = value


def make_objective(
    information: Any, space: JointSpace, goal: Sequence[float], planner: str, *, stop_at_first: bool
) -> Any:
    """The objective of an optimising planner.

    Args:
        information: OMPL's space information.
        space: the joint space.
        goal: d values in rad.
        planner: one of ``OPTIMISING_PLANNERS``.
        stop_at_first: whether every path is short enough.
    """
    objective: Any
    if planner == INFORMED_RRT_STAR:
        objective = TorusLengthByGoal(information, space, goal)
    else:
        objective = TorusLength(information, space)
    if planner == RRT_STAR:
        # It needs no estimates, and the wrapper spares it a look for Python's versions of all the rest.
        objective, length = ob.MultiOptimizationObjective(information), objective
        objective.addObjective(length, 1.0)
    if stop_at_first:
        objective.setCostThreshold(ob.Cost(ANY_COST))
    return objective
