"""The project's own RRT-Connect: the same search as OMPL's, with samples that are given."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from cspace.planning.rrt_connect import BLOCK, Trees, sampled_states
from cspace.worlds.planar.checks import CollisionChecker
from services.planner.ompl_planner import solve
from services.planner.result import Reason
from services.planner.settings import RRT_CONNECT, SAMPLED_CONNECT, PlannerSettings


def settings(seed=1, **changes):
    return PlannerSettings(**({"planner": SAMPLED_CONNECT, "seed": seed, "max_iterations": 20_000} | changes))


def test_with_uniform_samples_it_searches_as_ompl_s_does(narrow):
    kinds = (SAMPLED_CONNECT, RRT_CONNECT)
    counts, checks, states = {}, {}, {}
    for kind in kinds:
        found = [solve(narrow, settings(seed, planner=kind, range_rad=0.3)) for seed in range(150)]
        # A path that the finer check rejects now and then is either's.
        assert sum(one.solved for one in found) >= 145
        counts[kind] = [one.iterations for one in found]
        checks[kind] = [one.edge_checks for one in found]
        states[kind] = [one.state_checks for one in found]
    assert np.median(counts[RRT_CONNECT]) > 5
    for values in (counts, checks, states):
        assert mannwhitneyu(*(values[kind] for kind in kinds)).pvalue > 1e-3


def test_no_step_is_longer_than_the_range_and_every_edge_is_free(blocked):
    result = solve(blocked, settings(range_rad=0.4), keep_tree=True)
    assert result.solved
    assert (
        np.abs(blocked.scenario.robot.space.difference(result.path[:-1], result.path[1:])).sum(axis=1).max()
        <= 0.4 + 1e-9
    )
    ends = result.tree.vertices[result.tree.edges]
    assert CollisionChecker(blocked.scenario).edge_batch(ends[:, 0], ends[:, 1], 0.0314).all()
    # Two trees: one edge less than vertices in each.
    assert len(result.tree.edges) == len(result.tree.vertices) - 2


def test_given_samples_are_drawn_in_their_order_and_once_each(blocked):
    space = blocked.scenario.robot.space
    samples = np.random.default_rng(0).uniform(-9.0, 9.0, (40, 2))
    states, learned = sampled_states(space, samples, 0.5, 20_000, np.random.default_rng(3))
    np.testing.assert_allclose(states[learned], space.wrap(samples))
    assert 50 < np.flatnonzero(learned)[-1] < 120
    states, learned = sampled_states(space, samples, 0.0, 10, np.random.default_rng(3))
    assert learned.all()
    np.testing.assert_allclose(states, space.wrap(samples[:10]))
    assert not sampled_states(space, None, 0.0, 10, np.random.default_rng(3))[1].any()


def test_samples_along_the_path_are_all_that_is_needed(blocked):
    turns = np.linspace(0.0, -3.0, 31)
    tube = np.stack([turns, np.zeros_like(turns)], axis=-1)
    found = [solve(blocked, settings(seed), tube, 0.0) for seed in range(20)]
    assert all(one.solved and one.uniform_drawn == 0 for one in found)


@pytest.mark.slow
def test_a_long_search_outgrows_its_first_arrays(disconnected):
    result = solve(disconnected, settings(max_iterations=40_000, time_limit_s=120.0), keep_tree=True)
    assert result.reason == Reason.ITERATION_LIMIT
    trees = Trees(disconnected.start, disconnected.goal, BLOCK * 9)
    assert len(result.tree.vertices) > 2 * trees.nodes.shape[1]
    assert len(result.tree.edges) == len(result.tree.vertices) - 2
