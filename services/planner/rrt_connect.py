"""RRT-Connect that draws from an array of samples, which OMPL's can not, and that begins with known paths."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.planning.paths import NOISE_RAD, AlongPaths
from cspace.planning.rrt_connect import Growth, grow_connect, sampled_states
from cspace.query import AlternativePath
from cspace.simulator import Checker, EdgeTest, Problem
from cspace.space import JointSpace
from cspace.worlds import checker_of
from cspace_client.ompl import free_first
from services.planner.result import Counts, PlanResult, Reason, SearchTree, after, outcome
from services.planner.settings import PlannerSettings

SWEEP = 24
# Of a hop's length: many short hops cost less than one long one, so that chains stay within the cloud.
_POWER = 3


def order_along(
    samples: ArrayLike, start: ArrayLike, goal: ArrayLike, space: JointSpace, sweep: int = SWEEP
) -> NDArray[np.intp]:
    """The order of samples in sweeps from start to goal.

    Args:
        samples: (n, d) rad.
        start: (d,) rad.
        goal: (d,) rad.
        space: the joint space.
        sweep: samples from start to goal before the next begin at the start again.

    Returns:
        (n,) a permutation: every sweep rises from start to goal, and all are about equally long.
    """
    rows = np.asarray(samples, dtype=np.float64)
    if len(rows) == 0:
        return np.empty(0, dtype=np.intp)
    points = np.ascontiguousarray(space.wrap(np.concatenate([[start], rows, [goal]])))
    wraps = np.array(space.periodic, dtype=np.bool_)
    behind, ahead = _costs(points, wraps, 0)[1:-1], _costs(points, wraps, len(points) - 1)[1:-1]
    along = np.argsort(behind / np.maximum(behind + ahead, np.finfo(np.float64).tiny), kind="stable")
    sweeps = -(-len(rows) // max(1, sweep))
    rank = np.arange(len(rows))
    return np.asarray(along[np.argsort(rank % sweeps, kind="stable")], dtype=np.intp)


def colliding_last(samples: ArrayLike, checker: Checker) -> NDArray[np.intp]:
    """The order of samples in which those that collide come after all others; else it stays as it is.

    Args:
        samples: (n, d) rad.
        checker: of the scenario.

    Returns:
        (n,) a permutation.
    """
    rows = checker.space.wrap(np.asarray(samples, dtype=np.float64))
    free = checker.valid_batch(rows).tolist()
    return np.fromiter(free_first(range(len(free)), free.__getitem__), dtype=np.intp)


@njit(cache=True, nogil=True)
def _costs(points, wraps, source):  # type: ignore[no-untyped-def]
    """Cost of the cheapest chain of hops from each of (n, d) points to one of them, (n,)."""
    count, dim = points.shape
    costs = np.full(count, np.inf)
    costs[source] = 0.0
    done = np.zeros(count, dtype=np.bool_)
    for _ in range(count):
        at, least = -1, np.inf
        for index in range(count):
            if not done[index] and costs[index] < least:
                at, least = index, costs[index]
        done[at] = True
        for index in range(count):
            if done[index]:
                continue
            squared = 0.0
            for joint in range(dim):
                gap = abs(points[index, joint] - points[at, joint])
                if wraps[joint]:
                    gap = min(gap, 2.0 * np.pi - gap)
                squared += gap * gap
            costs[index] = min(costs[index], least + squared ** (_POWER / 2.0))
    return costs


def connect(
    problem: Problem,
    settings: PlannerSettings,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Grow both trees until they meet; see :func:`services.planner.ompl_planner.solve`.

    Args:
        problem: start and goal, both free.
        settings: of the planner; there is no goal bias.
        samples: (n, d) learned samples in rad, drawn in this order and once each; None for uniform ones.
        uniform_share: share of uniform samples while learned ones are left, 0 to 1.
        keep_tree: whether the result holds both trees.
    """
    space, checker = problem.space, checker_of(problem.scenario)
    began = time.perf_counter()
    looked_at = 0
    if samples is not None and settings.colliding_last:
        samples, looked_at = samples[colliding_last(samples, checker)], len(samples)
    sorted_s = time.perf_counter() - began
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    states, learned = sampled_states(space, samples, uniform_share, settings.max_iterations, rng)
    growth = Growth(settings.range_rad, settings.resolution_rad, settings.time_limit_s)
    grown = grow_connect(checker, problem.start, problem.goal, states, growth)
    learned_drawn = int(learned[: grown.iterations].sum())
    counts = Counts(
        iterations=grown.iterations,
        edge_checks=grown.edge_checks,
        state_checks=grown.state_checks + looked_at,
        solve_time_s=grown.time_s + sorted_s,
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


UNIFORM_SHARE = 0.3


def solve_with_paths(
    problem: Problem, settings: PlannerSettings, paths: Sequence[AlternativePath]
) -> PlanResult:
    """Solves a problem by the paths, or by RRT-Connect with configurations around them.

    Args:
        problem: start and goal, both free.
        settings: of the search; its planner is not looked at.
        paths: from the problem's start to its goal, the most confident first.

    Returns:
        Its counts are those of both: pieces are edges, states within them are states.
    """
    space, checker = problem.space, checker_of(problem.scenario)
    test = checker.edge_test(settings.resolution_rad)
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
    about = samples_around(
        [candidate.path for candidate in paths], space, np.random.default_rng(settings.seed)
    )
    left_s = max(settings.time_limit_s - spent.solve_time_s, 1e-3)
    grown = connect(problem, replace(settings, time_limit_s=left_s), about, UNIFORM_SHARE)
    return after(tried_first, grown)


def samples_around(
    paths: Sequence[NDArray[np.float64]], space: JointSpace, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Configurations about paths, (n, d) rad within the limits, in the order in which they are drawn."""
    if not paths:
        return None
    along = AlongPaths(paths, space, rng)
    return along.take(len(NOISE_RAD) * along.turn_rows)[0]


def _checked(test: EdgeTest, candidate: AlternativePath) -> tuple[bool, int, int]:
    """Whether a path is free, and how many states and pieces were looked at for that."""
    looked_at = 0
    for tried, piece in enumerate(np.argsort(candidate.edges, kind="stable"), start=1):
        free, count = test(candidate.path[piece], candidate.path[piece + 1])
        looked_at += count
        if not free:
            return False, looked_at, tried
    return True, looked_at, len(candidate.edges)
