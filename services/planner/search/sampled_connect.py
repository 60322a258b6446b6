"""RRT-Connect that draws from an array of samples, which OMPL cannot do."""

import time

import numpy as np
from numpy.typing import NDArray

from cspace.planning.rrt_connect import Growth, drawn_states, grow_connect
from cspace.simulator import Problem
from cspace.worlds import checker_of
from services.planner.plan_result import PlanResult, Reason, SearchTree
from services.planner.search.outcome import Counts, outcome
from services.planner.search.samples.sample_order import colliding_last
from services.planner.settings import PlannerSettings


def connect(
    problem: Problem,
    settings: PlannerSettings,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Grow both trees until they meet; see :func:`services.planner.search.ompl_planner.solve`.

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
    states, learned = drawn_states(space, samples, uniform_share, settings.max_iterations, rng)
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
