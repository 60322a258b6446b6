"""Ways that somebody believes in, checked as they are before any tree grows.

Pieces are checked in the order of doubt, the least sure of the surest way first, for what collides is found
soonest there. Where no way is free, RRT-Connect draws configurations about them: along one way after the
other, from start to goal, each time with more noise.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cspace.planning.paths import NOISE_RAD, AlongPaths
from cspace.query import BelievedWay
from cspace.simulator import EdgeTest, Problem
from cspace.space import JointSpace
from cspace.worlds import checker_of
from services.planner.plan_result import PlanResult, Reason
from services.planner.search.outcome import Counts, after, outcome
from services.planner.search.sampled_connect import connect
from services.planner.settings import PlannerSettings

UNIFORM_SHARE = 0.3


def solve_with_ways(problem: Problem, settings: PlannerSettings, ways: Sequence[BelievedWay]) -> PlanResult:
    """Solve a problem by the ways, or by RRT-Connect with configurations about them.

    Args:
        problem: start and goal, both free.
        settings: of the search; its planner is not looked at.
        ways: from the problem's start to its goal, the surest first.

    Returns:
        Its counts are those of both: pieces are edges, states within them are states.
    """
    space, checker = problem.space, checker_of(problem.scenario)
    test = checker.edge_test(settings.resolution_rad)
    began, edges, states = time.perf_counter(), 0, 0
    for way in ways:
        free, looked_at, tried = _checked(test, way)
        edges, states = edges + tried, states + looked_at
        if free:
            counts = Counts(edge_checks=edges, state_checks=states, solve_time_s=time.perf_counter() - began)
            found = outcome(problem, settings, way.way, Reason.NO_PATH, counts)
            if found.solved:
                return found
    spent = Counts(edge_checks=edges, state_checks=states, solve_time_s=time.perf_counter() - began)
    tried_first = outcome(problem, settings, None, Reason.NO_PATH, spent)
    about = drawn_about([way.way for way in ways], space, np.random.default_rng(settings.seed))
    left_s = max(settings.time_limit_s - spent.solve_time_s, 1e-3)
    grown = connect(problem, replace(settings, time_limit_s=left_s), about, UNIFORM_SHARE)
    return after(tried_first, grown)


def drawn_about(
    ways: Sequence[NDArray[np.float64]], space: JointSpace, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Configurations about ways, (n, d) rad within the limits, in the order in which they are drawn."""
    if not ways:
        return None
    along = AlongPaths(ways, space, rng)
    return along.take(len(NOISE_RAD) * along.turn_rows)[0]


def _checked(test: EdgeTest, way: BelievedWay) -> tuple[bool, int, int]:
    """Whether a way is free, and how many states and pieces were looked at for that."""
    looked_at = 0
    for tried, piece in enumerate(np.argsort(way.edges, kind="stable"), start=1):
        free, count = test(way.way[piece], way.way[piece + 1])
        looked_at += count
        if not free:
            return False, looked_at, tried
    return True, looked_at, len(way.edges)
