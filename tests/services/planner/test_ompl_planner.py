from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from cspace.errors import PlanningError
from cspace.simulator import Problem
from cspace.worlds.planar import collision
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import Scenario
from services.planner.ompl_planner import solve
from services.planner.result import (
    LEARNED_PLANNERS,
    PLANNERS,
    RRT_CONNECT,
    SAMPLED_CONNECT,
    PlannerSettings,
    Reason,
    check_path,
)

SETTINGS = PlannerSettings(max_iterations=2000, seed=1)


def uniform_samples(count, seed=0, dim=2):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, dim))


@pytest.mark.parametrize("planner", PLANNERS)
def test_uniform_planners_solve_with_a_free_path_from_start_to_goal(blocked, planner):
    result = solve(blocked, PlannerSettings(planner, seed=1))
    assert result.solved
    assert result.reason == Reason.SOLVED
    assert np.allclose(result.path[0], blocked.start)
    assert np.allclose(result.path[-1], blocked.goal, atol=1e-6)
    assert CollisionChecker(blocked.scenario).edge_batch(result.path[:-1], result.path[1:], 1e-3).all()
    assert result.learned_drawn == 0
    assert result.edge_checks < result.state_checks < 65 * result.edge_checks + 1000


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
def test_the_learned_sampler_is_called_and_all_that_a_planner_holds_comes_from_it(disconnected, planner):
    # OMPL ignores a sampler that it does not know, and still solves problems, with uniform samples.
    samples = uniform_samples(150)
    settings = PlannerSettings(planner, range_rad=100.0, goal_bias=0.0, max_iterations=150)
    result = solve(disconnected, settings, samples, 0.0, keep_tree=True)
    assert (result.learned_drawn, result.uniform_drawn) == (150, 0)
    known = np.concatenate([samples, [disconnected.start, disconnected.goal]])
    gaps = np.abs(result.tree.vertices[:, None] - known[None]).sum(axis=2)
    assert np.all(gaps.min(axis=1) < 1e-12)
    assert len(set(gaps.argmin(axis=1)) - {150, 151}) > 20


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
@pytest.mark.parametrize("samples", [None, uniform_samples(50)], ids=["uniform", "learned"])
def test_every_iteration_is_a_learned_or_a_uniform_state(disconnected, planner, samples):
    settings = PlannerSettings(planner, goal_bias=0.0, max_iterations=150, seed=2)
    result = solve(disconnected, settings, samples)
    assert (result.reason, result.iterations) == (Reason.ITERATION_LIMIT, 150)
    assert result.learned_drawn + result.uniform_drawn == 150
    assert result.learned_drawn == (0 if samples is None else 50)
    assert result.path.shape == (0, 2)
    assert np.isnan(result.length_rad)
    timed = solve(disconnected, PlannerSettings(planner, time_limit_s=1e-9), samples)
    assert (timed.reason, timed.iterations <= 1) == (Reason.TIME_LIMIT, True)


def test_the_hook_with_uniform_states_alone_is_no_better_or_worse_than_ompl_s_sampler(blocked):
    runs = [
        [solve(blocked, PlannerSettings(seed=seed), samples, 1.0).iterations for seed in range(100)]
        for samples in (None, np.zeros((1, 2)))
    ]
    assert mannwhitneyu(*runs).pvalue > 1e-3


@pytest.mark.parametrize("planner", PLANNERS)
def test_paths_do_not_go_round_limited_joints(planner):
    robot = PlanarArm(joint_limits_rad=((-7.0, 7.0), (-1.0, 1.0)))
    problem = Problem(
        Scenario(robot, ()), np.array([-6.9, 0.0]), np.array([6.9, 0.0]), Family.UNIFORM, 1.0, 0, 0
    )
    # Samples beyond the limits do no harm.
    rows = None if planner == RRT_CONNECT else np.random.default_rng(2).uniform(-12.0, 12.0, (60, 2))
    result = solve(problem, PlannerSettings(planner, seed=3, time_limit_s=20.0), rows, 0.5)
    assert result.solved
    assert robot.space.contains(result.path).all()
    assert np.diff(result.path[:, 0]).sum() == pytest.approx(13.8, abs=1e-5)


def test_rrt_star_that_goes_on_minimises_the_torus_length(make_problem):
    # Where nothing is in the way, every monotone path has the least sum, and only the straight one is short.
    problem = make_problem(start=(-1.0, -1.0), goal=(1.0, 1.0))
    first, further = (
        solve(problem, PlannerSettings("RRTstar", max_iterations=3000, stop_at_first=stop))
        for stop in (True, False)
    )
    assert further.length_rad < 1.01 * np.hypot(2.0, 2.0)
    assert further.length_rad <= first.length_rad + 1e-9
    assert first.iterations < further.iterations == 3000


def test_a_path_that_the_planner_believes_in_is_still_checked(disconnected, monkeypatch):
    monkeypatch.setattr(collision.KERNELS, "checked_edge", lambda *_: (True, 1))
    result = solve(disconnected, SETTINGS)
    assert (result.solved, result.reason, len(result.path)) == (False, Reason.REJECTED, 0)
    # The search begins again with what is left of its limits.
    first = result.iterations // 2
    limited = solve(disconnected, replace(SETTINGS, max_iterations=first))
    assert (limited.reason, limited.iterations) == (Reason.REJECTED, first)


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ([(0.0, 0.0), (-1.5, 0.0), (-3.0, 0.0)], Reason.SOLVED),
        ([(0.0, 0.0), (1.5, 0.0), (-3.0, 0.0)], Reason.REJECTED),
        ([(0.0, 0.0), (-3.0, 2e-6)], Reason.WRONG_ENDS),
        ([(0.1, 0.0), (-3.0, 0.0)], Reason.WRONG_ENDS),
        ([(-3.0, 0.0)], Reason.WRONG_ENDS),
    ],
)
def test_the_independent_check_looks_at_ends_and_edges(blocked, path, reason):
    assert check_path(blocked, np.array(path), 0.03) is reason


@pytest.mark.parametrize(
    ("ends", "reason"),
    [
        ({"start": (np.pi / 2, 0.0)}, Reason.START_COLLIDES),
        ({"goal": (np.pi / 2, 0.0)}, Reason.GOAL_COLLIDES),
    ],
)
def test_an_end_in_collision_is_named(make_problem, ends, reason):
    assert solve(make_problem([(0.0, 3.0)], **ends), SETTINGS).reason == reason


@pytest.mark.parametrize("samples", [np.zeros((4, 3)), [[np.nan, 0.0]]], ids=["another robot's", "nan"])
def test_samples_that_do_not_fit_are_an_error(blocked, samples):
    with pytest.raises(PlanningError, match="samples do not fit"):
        solve(blocked, PlannerSettings(SAMPLED_CONNECT), samples)


def test_an_error_in_a_callback_reaches_the_caller_and_the_next_solve_works(blocked, monkeypatch, capfd):
    with monkeypatch.context() as patch:
        patch.setattr(collision.KERNELS, "checked_edge", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            solve(blocked, SETTINGS)
    assert solve(blocked, SETTINGS, np.empty((0, 2))).solved
    assert capfd.readouterr() == ("", "")
