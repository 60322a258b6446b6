"""What a planner returns."""

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
    """The tree (two for RRTConnect) when the search ended.

    Args:
        vertices: (V, d) rad.
        edges: (E, 2) indices into the vertices.
    """

    vertices: NDArray[np.float64]
    edges: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """One run of a planner.

    Args:
        solved: a path from the start to within 1e-6 rad of the goal passed the check at ten times the
            resolution.
        path: (k, d) rad; (0, d) unless solved.
        length_rad: torus length (L2) of the path; nan unless solved.
        iterations: states that the planner drew, the goal among them.
        edge_checks: motions that the planner had checked.
        solve_time_s: wall time of the search alone.
        learned_drawn: how many of the drawn states came from the batch of learned samples.
        uniform_drawn: how many were uniform.
        reason: why the search ended.
        tree: the search tree, where it was asked for.
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
