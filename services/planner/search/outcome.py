"""From a finished search to its result: the path judged, the counts kept."""

from dataclasses import asdict, dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from cspace.simulator import Problem
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
        reason=reason,
        tree=tree,
        resolution_rad=settings.resolution_rad,
        costs=costs if solved else (),
        **asdict(counts),
    )


def after(first: PlanResult, second: PlanResult) -> PlanResult:
    """The second search's result, with what both of them took."""
    costs = tuple(
        replace(
            point,
            iterations=point.iterations + first.iterations,
            edge_checks=point.edge_checks + first.edge_checks,
            time_s=point.time_s + first.solve_time_s,
        )
        for point in second.costs
    )
    counts = {one.name: getattr(first, one.name) + getattr(second, one.name) for one in fields(Counts)}
    return replace(second, **counts, costs=costs)
