"""RRT-Connect that draws from given samples, which OMPL's can not, and that begins with known paths."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cspace.planning.paths import NOISE_RAD, AlongPaths
from cspace.planning.rrt_connect import Growth, grow_connect, sampled_states
from cspace.query import AlternativePath
from cspace.simulator import EdgeTest, Problem
from cspace.worlds import checker_of
from services.planner.result import Counts, PlannerSettings, PlanResult, Reason, SearchTree, after, outcome

UNIFORM_SHARE = 0.3


def connect(
    problem: Problem,
    settings: PlannerSettings,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Grows both trees until they meet; the arguments are those of ``solve``, both ends are free."""
    checker = checker_of(problem.scenario)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    states, learned = sampled_states(problem.space, samples, uniform_share, settings.max_iterations, rng)
    growth = Growth(settings.range_rad, settings.resolution_rad, settings.time_limit_s)
    grown = grow_connect(checker, problem.start, problem.goal, states, growth)
    learned_drawn = int(learned[: grown.iterations].sum())
    counts = Counts(
        iterations=grown.iterations,
        edge_checks=grown.edge_checks,
        state_checks=grown.state_checks,
        solve_time_s=grown.time_s,
        learned_drawn=learned_drawn,
        uniform_drawn=grown.iterations - learned_drawn,
    )
    tree = None
    if keep_tree:
        children = np.flatnonzero(grown.parents >= 0)
        edges = np.stack([grown.parents[children], children], axis=1)
        tree = SearchTree(grown.nodes, edges.astype(np.intp))
    reason = Reason.TIME_LIMIT if grown.timed_out else Reason.ITERATION_LIMIT
    return outcome(problem, settings, grown.path, reason, counts, tree=tree)


def solve_with_paths(
    problem: Problem, settings: PlannerSettings, paths: Sequence[AlternativePath]
) -> PlanResult:
    """Solves a problem by one of the paths, or by RRT-Connect with configurations around them.

    The checks of the paths are among the result's counts.
    """
    test = checker_of(problem.scenario).edge_test(settings.resolution_rad)
    began, edges, states = time.perf_counter(), 0, 0
    for candidate in paths:
        free, looked_at, tried = _checked(test, candidate)
        edges, states = edges + tried, states + looked_at
        if free:
            counts = Counts(edge_checks=edges, state_checks=states, solve_time_s=time.perf_counter() - began)
            found = outcome(problem, settings, candidate.path, Reason.NO_PATH, counts)
            if found.solved:
                return found
    spent = Counts(edge_checks=edges, state_checks=states, solve_time_s=time.perf_counter() - began)
    tried_first = outcome(problem, settings, None, Reason.NO_PATH, spent)
    around = None
    if paths:
        rng = np.random.default_rng(settings.seed)
        along = AlongPaths([candidate.path for candidate in paths], problem.space, rng)
        around = along.take(len(NOISE_RAD) * along.turn_rows)[0]
    left_s = max(settings.time_limit_s - spent.solve_time_s, 1e-3)
    return after(tried_first, connect(problem, replace(settings, time_limit_s=left_s), around, UNIFORM_SHARE))


def _checked(test: EdgeTest, candidate: AlternativePath) -> tuple[bool, int, int]:
    """Whether a path is free, and how many states and edges were checked for that; the least sure first."""
    looked_at = 0
    for tried, piece in enumerate(np.argsort(candidate.edges, kind="stable"), start=1):
        free, count = test(candidate.path[piece], candidate.path[piece + 1])
        looked_at += count
        if not free:
            return False, looked_at, tried
    return True, looked_at, len(candidate.edges)
