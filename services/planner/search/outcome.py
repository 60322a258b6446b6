"""From a finished search to its result: the path judged, the counts kept."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cspace.problem import Problem
from services.planner.plan_result import CostPoint, PlanResult, Reason, SearchTree
from services.planner.search.path_check import judge_path, path_length_rad
from services.planner.settings import PlannerSettings


@dataclass(frozen=True, slots=True)
class Counts:
    """What a search took; see :class:`services.planner.plan_result.PlanResult`."""

    iterations: int = 0
    edge_checks: int = 0
    state_checks: int = 0
    solve_time_s: float = 0.0
    learned_drawn: int = 0
    uniform_drawn: int = 0


def outcome(
    problem: Problem,
    settings: PlannerSettings,
    found: NDArray[np.float64] | None,
    reason: Reason,
    counts: Counts,
    *,
    tree: SearchTree | None = None,
    costs: tuple[CostPoint, ...] = (),
) -> PlanResult:
    """The result of a search.

    Args:
        problem: that was to be solved.
        settings: of the planner.
        found: (k, d) rad, the path that the planner believes in; None if it found none.
        reason: why the search ended, for the case that there is no path.
        counts: what it took.
        tree: the search tree, where it was asked for.
        costs: how the length fell.
    """
    path = np.empty((0, problem.space.dim))
    if found is not None:
        reason = judge_path(problem, found, settings.resolution_rad)
        path = found if reason is Reason.SOLVED else path
    path.setflags(write=False)
    solved = reason is Reason.SOLVED
    return PlanResult(
        solved=solved,
        path=path,
        length_rad=path_length_rad(problem, path) if solved else float("nan"),
        iterations=counts.iterations,
        edge_checks=counts.edge_checks,
        solve_time_s=counts.solve_time_s,
        learned_drawn=counts.learned_drawn,
        uniform_drawn=counts.uniform_drawn,
        reason=reason,
        tree=tree,
        state_checks=counts.state_checks,
        resolution_rad=settings.resolution_rad,
        costs=costs if solved else (),
    )


def after(first: PlanResult, second: PlanResult) -> PlanResult:
    """The second search's result, with what both of them took."""
    costs = tuple(
        CostPoint(
            point.iterations + first.iterations,
            point.edge_checks + first.edge_checks,
            point.time_s + first.solve_time_s,
            point.length_rad,
        )
        for point in second.costs
    )
    return replace(
        second,
        iterations=first.iterations + second.iterations,
        edge_checks=first.edge_checks + second.edge_checks,
        state_checks=first.state_checks + second.state_checks,
        solve_time_s=first.solve_time_s + second.solve_time_s,
        learned_drawn=first.learned_drawn + second.learned_drawn,
        uniform_drawn=first.uniform_drawn + second.uniform_drawn,
        costs=costs,
    )
