"""The project's own RRT-Connect: the same search as OMPL's, with samples or paths that are given."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from cspace.query import AlternativePath
from cspace.worlds.planar.collision import CollisionChecker
from services.planner.ompl_planner import solve, solve_with_paths
from services.planner.result import RRT_CONNECT, SAMPLED_CONNECT, PlannerSettings


def settings(seed=1, **changes):
    return PlannerSettings(**({"planner": SAMPLED_CONNECT, "seed": seed, "max_iterations": 20_000} | changes))


def test_with_uniform_samples_it_searches_as_ompl_s_does(narrow):
    found = {
        kind: [solve(narrow, settings(seed, planner=kind, range_rad=0.3)) for seed in range(100)]
        for kind in (SAMPLED_CONNECT, RRT_CONNECT)
    }
    for name in ("iterations", "edge_checks", "state_checks"):
        ours, theirs = ([getattr(one, name) for one in results] for results in found.values())
        assert mannwhitneyu(ours, theirs).pvalue > 1e-3


def test_no_step_is_longer_than_the_range_and_every_edge_is_free(blocked):
    result = solve(blocked, settings(range_rad=0.4), keep_tree=True)
    assert result.solved
    steps = blocked.scenario.robot.space.difference(result.path[:-1], result.path[1:])
    assert np.abs(steps).sum(axis=1).max() <= 0.4 + 1e-9
    ends = result.tree.vertices[result.tree.edges]
    assert CollisionChecker(blocked.scenario).edge_batch(ends[:, 0], ends[:, 1], 0.0314).all()
    # Two trees: one edge less than vertices in each.
    assert len(result.tree.edges) == len(result.tree.vertices) - 2


def alternative(path):
    return AlternativePath(np.asarray(path), 0.5, np.full(len(path) - 1, 0.9, np.float32))


@pytest.fixture
def free_path(narrow):
    return alternative(solve(narrow, settings(3)).path)


@pytest.fixture
def wrong(narrow):
    straight = np.stack([narrow.start, narrow.goal])
    assert not CollisionChecker(narrow.scenario).edge_batch(straight[:1], straight[1:], 0.01)[0]
    return alternative(straight)


def test_the_first_free_path_is_the_solution_and_no_tree_grows(narrow, free_path, wrong):
    found = solve_with_paths(narrow, settings(3), [wrong, free_path])
    np.testing.assert_array_equal(found.path, free_path.path)
    assert (found.iterations, found.edge_checks) == (0, 1 + len(free_path.edges))
    assert found.state_checks >= found.edge_checks


def test_where_no_path_is_free_the_search_draws_around_them(narrow, wrong):
    found = solve_with_paths(narrow, settings(3), [wrong])
    assert found.solved
    assert found.learned_drawn > 0
