"""Settings of a planner, and its result: the path after an independent check, and what the search took."""

import math
from dataclasses import asdict, dataclass, fields, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cspace.planning.paths import length_rad
from cspace.simulator import Problem
from cspace.worlds import checker_of

RRT = "RRT"
RRT_STAR = "RRTstar"
RRT_CONNECT = "RRTConnect"
SAMPLED_CONNECT = "SampledRRTConnect"
PLANNERS = (RRT, RRT_STAR, RRT_CONNECT, SAMPLED_CONNECT)
LEARNED_PLANNERS = (RRT, RRT_STAR, SAMPLED_CONNECT)
"""Planners that can draw learned samples; OMPL's RRTConnect draws uniform ones only."""


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How a problem is solved.

    The range is the longest step of a tree in OMPL's metric (the sum over the joints), the resolution the
    largest distance between checked states of an edge in any joint. RRT-Connect has no goal bias. A search
    ends after so many drawn states. RRT* alone can go on after its first solution.
    """

    planner: str = RRT
    range_rad: float = 1.0
    resolution_rad: float = 0.0314
    goal_bias: float = 0.05
    time_limit_s: float = 10.0
    max_iterations: int = 5000
    seed: int = 1
    stop_at_first: bool = True


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

    Iterations are drawn states, free or not, the goal among them; edges are motions. The time is that of the
    search alone. Learned and uniform states are those of the drawn ones.
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

    It is solved where a path from the start to within 1e-6 rad of the goal passed the check at a tenth of the
    resolution. The path is (k, d) rad, (0, d) unless solved; its torus length (L2) is nan unless solved.
    """

    solved: bool
    path: NDArray[np.float64]
    length_rad: float
    reason: str
    tree: SearchTree | None = None
    resolution_rad: float = math.nan


def check_path(problem: Problem, path: NDArray[np.float64], resolution_rad: float) -> Reason:
    """Solved if a path (k, d) rad joins both ends, free at a tenth of the resolution; else what is wrong."""
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
