"""The check of a finished path that trusts nothing of the planner."""

import numpy as np
from numpy.typing import NDArray

from cspace.simulator import Problem
from cspace.worlds import checker_of
from services.planner.plan_result import Reason

GOAL_TOLERANCE_RAD = 1e-6
CHECK_FACTOR = 10.0


def judge_path(problem: Problem, path: NDArray[np.float64], resolution_rad: float) -> Reason:
    """Whether a path leads from start to goal and is free at ten times the resolution.

    Args:
        problem: start, goal and scenario.
        path: (k, d) rad.
        resolution_rad: the planner's.

    Returns:
        ``Reason.SOLVED``, or what is wrong.
    """
    space = problem.space
    if len(path) < 2:
        return Reason.WRONG_ENDS
    ends = space.distance(path[[0, -1]], np.stack([problem.start, problem.goal]))
    if not np.all(ends <= GOAL_TOLERANCE_RAD):
        return Reason.WRONG_ENDS
    checker = checker_of(problem.scenario)
    free = checker.edge_batch(path[:-1], path[1:], resolution_rad / CHECK_FACTOR)
    return Reason.SOLVED if np.all(free) else Reason.REJECTED


def path_length_rad(problem: Problem, path: NDArray[np.float64]) -> float:
    """Torus length of a path (k, d): the sum of its segments' L2 lengths, rad.

    OMPL's own length adds up the joints (L1) on a product of circles.
    """
    return float(np.sum(problem.space.distance(path[:-1], path[1:])))
