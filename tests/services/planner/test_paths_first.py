"""Ways are checked as they are, the least sure piece first, before RRT-Connect draws about them."""

import numpy as np
import pytest

from cspace.query import AlternativePath
from cspace.simulator import Split
from cspace.worlds import checker_of, examples, simulator_of
from services.planner import rrt_connect
from services.planner.ompl_planner import solve
from services.planner.result import Reason
from services.planner.rrt_connect import solve_with_paths
from services.planner.settings import SAMPLED_CONNECT, PlannerSettings

WORLD = examples()["two-link"]
SIMULATOR = simulator_of(WORLD)
SETTINGS = PlannerSettings(planner=SAMPLED_CONNECT, max_iterations=20_000, seed=3)


@pytest.fixture(scope="module")
def problem():
    return SIMULATOR.problem("narrow", Split.VALIDATION, 0, 1)


@pytest.fixture(scope="module")
def free_way(problem):
    found = solve(problem, SETTINGS)
    assert found.solved
    return alternative(found.path)


def alternative(way, edges=None):
    edges = np.full(len(way) - 1, 0.9) if edges is None else np.array(edges)
    return AlternativePath(np.asarray(way), 0.5, edges.astype(np.float32))


def straight(problem):
    found = alternative(np.stack([problem.start, problem.goal]))
    assert not checker_of(problem.scenario).edge_batch(found.path[:1], found.path[1:], 0.01)[0]
    return found


def test_a_way_that_is_free_is_the_path_and_no_tree_grows(problem, free_way):
    found = solve_with_paths(problem, SETTINGS, [free_way])
    assert found.solved
    np.testing.assert_array_equal(found.path, free_way.path)
    assert (found.iterations, found.edge_checks) == (0, len(free_way.edges))
    assert found.state_checks >= found.edge_checks


def test_the_least_sure_piece_is_looked_at_first(problem, free_way, monkeypatch):
    edges = np.linspace(0.9, 0.5, len(free_way.edges))
    looked_at = []

    class Watched:
        def edge_test(self, resolution_rad):
            def test(start, goal):
                looked_at.append((start, goal))
                return False, 7

            return test

    plain = solve(problem, SETTINGS)
    monkeypatch.setattr(rrt_connect, "checker_of", lambda scene: Watched())
    monkeypatch.setattr(rrt_connect, "connect", lambda *given: plain)
    found = solve_with_paths(problem, SETTINGS, [alternative(free_way.path, edges)])
    np.testing.assert_array_equal(looked_at[0], free_way.path[-2:])
    assert len(looked_at) == 1
    assert (found.state_checks, found.edge_checks) == (plain.state_checks + 7, plain.edge_checks + 1)


def test_where_no_way_is_free_the_search_draws_about_them(problem, free_way):
    wrong = straight(problem)
    found = solve_with_paths(problem, SETTINGS, [wrong])
    assert found.solved
    assert found.learned_drawn > 0
    assert found.state_checks > 0
    second = solve_with_paths(problem, SETTINGS, [wrong, free_way])
    assert (second.iterations, second.edge_checks) == (0, 1 + len(free_way.edges))


def test_without_ways_it_is_the_uniform_search(problem):
    plain, found = solve(problem, SETTINGS), solve_with_paths(problem, SETTINGS, [])
    assert (found.state_checks, found.edge_checks) == (plain.state_checks, plain.edge_checks)
    np.testing.assert_array_equal(found.path, plain.path)
    assert found.reason is Reason.SOLVED
