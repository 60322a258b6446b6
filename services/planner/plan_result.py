"""What a planner returns."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class Reason(StrEnum):
    """Why a search ended, in words."""

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
    """The tree when the search ended: two for RRTConnect, PRM's roadmap without lone vertices.

    For BIT* all motions that it found free, of which its tree is a part.

    Args:
        vertices: (V, d) rad.
        edges: (E, 2) indices into the vertices.
    """

    vertices: NDArray[np.float64]
    edges: NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class CostPoint:
    """A path of an optimising planner that was shorter than all before.

    Args:
        iterations: states that the planner had drawn.
        edge_checks: motions that it had had checked.
        time_s: since the search began.
        length_rad: torus length (L2) of the path, which was checked at the planner's resolution only.
    """

    iterations: int
    edge_checks: int
    time_s: float
    length_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """One run of a planner.

    Args:
        solved: a path from the start to within 1e-6 rad of the goal passed the check at ten times the
            resolution.
        path: (k, d) rad; (0, d) unless solved.
        length_rad: torus length (L2) of the path; nan unless solved.
        iterations: states that the planner drew, free or not, the goal among them; for PRM without the goal,
            which it holds from the start. InformedRRT* counts those that its sampler gave up as well.
        edge_checks: motions that the planner had checked.
        solve_time_s: wall time of the search alone.
        learned_drawn: how many of the drawn states came from the batch of learned samples.
        uniform_drawn: how many were uniform.
        reason: why the search ended.
        tree: the search tree, where it was asked for.
        state_checks: states that were looked at, within motions and alone.
        resolution_rad: largest distance between checked states of a motion in any joint.
        costs: how the length fell, from the first solution on; empty unless solved by an optimising planner.
    """

    solved: bool
    path: NDArray[np.float64]
    length_rad: float
    iterations: int
    edge_checks: int
    solve_time_s: float
    learned_drawn: int
    uniform_drawn: int
    reason: str
    tree: SearchTree | None = None
    state_checks: int = 0
    resolution_rad: float = math.nan
    costs: tuple[CostPoint, ...] = ()
