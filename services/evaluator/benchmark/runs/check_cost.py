"""What a collision check costs: the kernel alone, on edges like those that a planner tries."""

import time

import numpy as np
from numpy.typing import NDArray

from cspace.problem import Problem
from cspace.workshop import Checker
from cspace.worlds import checker_of

EDGES = 1000
REPEATS = 5


def state_check_s(problem: Problem, range_rad: float, resolution_rad: float) -> float:
    """Seconds a state that is looked at, the fastest of five loops over 1000 edges.

    An edge leads from a free configuration towards a uniform one, as far as the planner's range, the way a
    tree grows. The loop is compiled, so neither OMPL nor the step from OMPL to Python counts: what those take
    belongs to the planner.

    Args:
        problem: whose scenario.
        range_rad: longest edge, in OMPL's metric (the sum over the joints), rad.
        resolution_rad: largest distance between checked states in any joint, rad.
    """
    checker = checker_of(problem.scenario)
    starts, ends = _edges(problem, checker, range_rad)
    edge_test = checker.edge_test(resolution_rad)
    looked = sum(int(edge_test(start, end)[1]) for start, end in zip(starts, ends, strict=True))
    taken = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        checker.edge_batch(starts, ends, resolution_rad)
        taken.append(time.perf_counter() - began)
    return min(taken) / looked


def _edges(
    problem: Problem, checker: Checker, range_rad: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    space, rng = problem.space, np.random.default_rng(0)
    drawn = space.sample_uniform(rng, EDGES)
    starts = np.concatenate([np.stack([problem.start, problem.goal]), drawn[checker.valid_batch(drawn)]])
    starts = starts[rng.integers(0, len(starts), EDGES)]
    gaps = space.difference(starts, space.sample_uniform(rng, EDGES))
    lengths = np.abs(gaps).sum(axis=1, keepdims=True)
    ends = space.wrap(starts + gaps * np.minimum(1.0, range_rad / np.maximum(lengths, 1e-12)))
    return starts, ends
