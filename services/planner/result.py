"""What a planner returns: the path after an independent check, and what the search took."""

import math
from dataclasses import asdict, dataclass, fields, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cspace.planning.paths import length_rad
from cspace.simulator import Problem
from cspace.worlds import checker_of
from services.planner.settings import PlannerSettings

GOAL_TOLERANCE_RAD = 1e-6
# Paths are checked at the planner's resolution divided by this.
CHECK_FACTOR = 10.0


class Reason(StrEnum):
    """Why a search ended."""

    SOLVED = "solved"
    START_COLLIDES = "the start is not a free configuration"
    GOAL_COLLIDES = "the goal is not a free configuration"
    ITERATION_LIMIT = "the iteration limit was reached"
    TIME_LIMIT = "the time limit was reached"
    NO_PATH = "the planner ended without a path"
    WRONG_ENDS = "the path does not lead from the start to the goal"
    REJECTED = "the independent check rejected the path"


@dataclass(frozen=True, slots=True, eq=False)
class SearchTree:
    """The tree when the search ended, two for RRT-Connect: (V, d) rad, and (E, 2) indices of vertices."""

    vertices: NDArray[np.float64]
    edges: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Counts:
    """What a search took.

    Args:
        iterations: states that the planner drew, free or not, the goal among them.
        edge_checks: motions that the planner had checked.
        state_checks: states that were checked, within motions and alone.
        solve_time_s: wall time of the search alone.
        learned_drawn: how many of the drawn states came from the batch of learned samples.
        uniform_drawn: how many were uniform.
    """

    iterations: int = 0
    edge_checks: int = 0
    state_checks: int = 0
    solve_time_s: float = 0.0
    learned_drawn: int = 0
    uniform_drawn: int = 0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlanResult(Counts):
    """One run of a planner.

    Args:
        solved: a path from the start to within 1e-6 rad of the goal passed the check at a tenth of the
            resolution.
        path: (k, d) rad; (0, d) unless solved.
        length_rad: torus length (L2) of the path; nan unless solved.
        reason: why the search ended.
        tree: the search tree, where it was asked for.
        resolution_rad: largest distance between checked states of a motion in any joint.
    """

    solved: bool
    path: NDArray[np.float64]
    length_rad: float
    reason: str
    tree: SearchTree | None = None
    resolution_rad: float = math.nan


def check_path(problem: Problem, path: NDArray[np.float64], resolution_rad: float) -> Reason:
    """Whether a path (k, d) rad leads from start to goal and is free at a tenth of the planner's resolution.

    Returns:
        ``Reason.SOLVED``, or what is wrong.
    """
    if len(path) < 2:
        return Reason.WRONG_ENDS
    ends = problem.space.distance(path[[0, -1]], np.stack([problem.start, problem.goal]))
    if not np.all(ends <= GOAL_TOLERANCE_RAD):
        return Reason.WRONG_ENDS
    checker = checker_of(problem.scenario)
    free = checker.edge_batch(path[:-1], path[1:], resolution_rad / CHECK_FACTOR)
    return Reason.SOLVED if np.all(free) else Reason.REJECTED


def outcome(
    problem: Problem,
    settings: PlannerSettings,
    found: NDArray[np.float64] | None,
    reason: Reason,
    counts: Counts,
    *,
    tree: SearchTree | None = None,
) -> PlanResult:
    """The result of a search: ``found`` is the planner's path, ``reason`` holds where it is None."""
    path = np.empty((0, problem.space.dim))
    if found is not None:
        reason = check_path(problem, found, settings.resolution_rad)
        path = found if reason is Reason.SOLVED else path
    path.setflags(write=False)
    solved = reason is Reason.SOLVED
    return PlanResult(
        solved=solved,
        path=path,
        length_rad=length_rad(path, problem.space) if solved else math.nan,
        reason=reason,
        tree=tree,
        resolution_rad=settings.resolution_rad,
        **asdict(counts),
    )


def after(first: PlanResult, second: PlanResult) -> PlanResult:
    """The second search's result, with what both searches took."""
    counts = {one.name: getattr(first, one.name) + getattr(second, one.name) for one in fields(Counts)}
    return replace(second, **counts)
