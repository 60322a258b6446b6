"""Planners that check learned samples and take those that collide after all others."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.worlds.planar.checks import CollisionChecker
from services.planner.ompl_planner import solve
from services.planner.rrt_connect import colliding_last
from services.planner.settings import LEARNED_PLANNERS, PlannerSettings

SAMPLES = np.random.default_rng(0).uniform(-np.pi, np.pi, (60, 2))


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
def test_the_search_is_that_over_samples_in_that_order_and_counts_its_checks(disconnected, planner):
    checker = CollisionChecker(disconnected.scenario)
    assert 10 < checker.valid_batch(SAMPLES).sum() < 50
    settings = PlannerSettings(planner, max_iterations=300, seed=3)
    sorted_before = solve(disconnected, settings, SAMPLES[colliding_last(SAMPLES, checker)], 0.2)
    found = solve(disconnected, replace(settings, colliding_last=True), SAMPLES, 0.2)
    for name in ("iterations", "edge_checks", "learned_drawn", "uniform_drawn"):
        assert getattr(found, name) == getattr(sorted_before, name)
    assert found.learned_drawn == 60
    assert found.state_checks == sorted_before.state_checks + 60


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
def test_a_path_is_the_one_over_samples_in_that_order(narrow, planner):
    settings = PlannerSettings(planner, max_iterations=20_000, seed=3)
    order = colliding_last(SAMPLES, CollisionChecker(narrow.scenario))
    sorted_before = solve(narrow, settings, SAMPLES[order], 0.2)
    found = solve(narrow, replace(settings, colliding_last=True), SAMPLES, 0.2)
    assert found.solved
    assert np.array_equal(found.path, sorted_before.path)
    assert found.state_checks > sorted_before.state_checks


def test_only_samples_whose_turn_comes_are_checked(make_problem):
    # Nothing is in the way, so a few samples are enough.
    problem, settings = make_problem(), PlannerSettings(goal_bias=0.5, seed=1)
    plain, found = (
        solve(problem, replace(settings, colliding_last=last), SAMPLES, 0.0) for last in (False, True)
    )
    assert found.learned_drawn == plain.learned_drawn < 60
    assert found.state_checks == plain.state_checks + found.learned_drawn
