import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from cspace.errors import ConfigError, PlanningError
from cspace.worlds.planar import checks
from cspace.worlds.planar.arm import THREE_LINK
from cspace.worlds.planar.checks import CollisionChecker
from services.planner.ompl_adapters import EdgeValidator, StateValidator
from services.planner.ompl_planner import solve
from services.planner.result import Reason
from services.planner.settings import (
    LEARNED_PLANNERS,
    PLANNERS,
    PRM,
    RRT,
    SAMPLED_CONNECT,
    PlannerSettings,
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
    edges = CollisionChecker(blocked.scenario).edge_batch(result.path[:-1], result.path[1:], 1e-3)
    assert np.all(edges)
    assert result.learned_drawn == 0


def test_the_length_is_the_torus_length_of_the_path(make_problem):
    problem = make_problem(start=(3.0, 0.0), goal=(-3.0, 0.3))
    result = solve(problem, PlannerSettings(range_rad=10.0, goal_bias=1.0))
    assert len(result.path) == 2
    assert result.length_rad == pytest.approx(np.hypot(2 * np.pi - 6.0, 0.3))


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
@pytest.mark.parametrize("samples", [None, uniform_samples(50)], ids=["uniform", "learned"])
def test_every_iteration_is_the_goal_or_a_learned_or_a_uniform_state(disconnected, planner, samples):
    settings = PlannerSettings(planner, goal_bias=0.0, max_iterations=150, seed=2)
    result = solve(disconnected, settings, samples)
    assert result.reason == Reason.ITERATION_LIMIT
    assert result.iterations == 150
    assert result.learned_drawn + result.uniform_drawn == 150
    # The goal's tree, whose turn is every second one, looks at a state before its edge.
    assert result.edge_checks >= (75 if planner == SAMPLED_CONNECT else 150)
    assert result.learned_drawn == (0 if samples is None else 50)


def test_without_samples_the_planner_is_ompl_s_own_rrt(blocked):
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    from cspace_client.ompl import StateAccess, make_state_space
    from services.planner.ompl_adapters import _ompl_seed

    ours = solve(blocked, SETTINGS)
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(_ompl_seed(SETTINGS.seed))
    space = blocked.scenario.robot.space
    access, checker = StateAccess(space), CollisionChecker(blocked.scenario)
    information = ob.SpaceInformation(make_state_space(space))
    information.setStateValidityChecker(StateValidator(checker))
    information.setMotionValidator(EdgeValidator(information, checker, SETTINGS.resolution_rad))
    information.setup()
    start, goal = information.allocState(), information.allocState()
    access.write(start, blocked.start.tolist())
    access.write(goal, blocked.goal.tolist())
    definition = ob.ProblemDefinition(information)
    definition.setStartAndGoalStates(start, goal, 1e-9)
    planner = og.RRT(information)
    planner.setRange(SETTINGS.range_rad)
    planner.setGoalBias(SETTINGS.goal_bias)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(10.0)
    assert np.array_equal(access.rows(definition.getSolutionPath().getStates()), ours.path)


def test_the_hook_with_uniform_states_alone_is_no_better_or_worse_than_ompl_s_sampler(blocked):
    runs = [
        [solve(blocked, PlannerSettings(seed=seed), samples, 1.0).iterations for seed in range(100)]
        for samples in (None, np.zeros((1, 2)))
    ]
    assert mannwhitneyu(*runs).pvalue > 1e-3


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
def test_all_that_a_planner_holds_is_learned_samples_and_the_ends(disconnected, planner):
    samples = uniform_samples(150)
    settings = PlannerSettings(planner, range_rad=100.0, goal_bias=0.0, max_iterations=150)
    result = solve(disconnected, settings, samples, 0.0, keep_tree=True)
    assert (result.learned_drawn, result.uniform_drawn) == (150, 0)
    known = np.concatenate([samples, [disconnected.start, disconnected.goal]])
    gaps = np.abs(result.tree.vertices[:, None] - known[None]).sum(axis=2)
    assert np.all(gaps.min(axis=1) < 1e-12)
    assert len(set(gaps.argmin(axis=1)) - {150, 151}) > 20


@pytest.mark.parametrize("planner", PLANNERS)
def test_states_are_counted_beside_the_edges_they_lie_on(disconnected, planner, monkeypatch):
    looks = []
    checked = checks.KERNELS.checked_edge

    def noted(*arguments):
        found = checked(*arguments)
        looks.append(found[1])
        return found

    monkeypatch.setattr(checks.KERNELS, "checked_edge", noted)
    result = solve(disconnected, PlannerSettings(planner, max_iterations=200, resolution_rad=0.05))
    assert result.resolution_rad == 0.05
    if planner != SAMPLED_CONNECT:
        # Each set-up looks at one edge to load the compiled kernel.
        assert result.edge_checks == len(looks) - 1
        assert result.state_checks >= sum(looks[1:])
    # An edge of at most half a turn has 63 steps of 0.05 rad, and its end is looked at twice.
    assert result.edge_checks < result.state_checks < 65 * result.edge_checks + 1000


def test_samples_outside_of_the_circle_are_wrapped(make_problem):
    settings = PlannerSettings(range_rad=100.0, goal_bias=0.0, max_iterations=1)
    result = solve(make_problem(), settings, [[np.pi + 0.5, -4.0]], 0.0, keep_tree=True)
    assert result.tree is not None
    added = result.tree.vertices[np.any(result.tree.vertices != 0.0, axis=1)]
    assert np.allclose(added, [[0.5 - np.pi, 2 * np.pi - 4.0]])


@pytest.mark.parametrize("planner", [RRT, SAMPLED_CONNECT, PRM])
def test_the_time_limit_ends_a_search(disconnected, planner):
    result = solve(disconnected, PlannerSettings(planner, time_limit_s=1e-9))
    assert result.reason == Reason.TIME_LIMIT
    assert result.iterations <= 1
    assert result.path.shape == (0, 2)
    assert np.isnan(result.length_rad)


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
def test_a_three_link_arm_works_through_the_same_code(make_problem, planner):
    problem = make_problem([(0.0, 2.5), (2.5, -2.0)], (0.0, 0.0, 0.0), (-3.0, 0.5, -0.5), THREE_LINK)
    result = solve(problem, PlannerSettings(planner, max_iterations=20_000), uniform_samples(200, dim=3))
    assert result.solved
    assert result.path.shape[1] == 3


def test_a_path_that_the_planner_believes_in_is_still_checked(disconnected, monkeypatch):
    monkeypatch.setattr(checks.KERNELS, "checked_edge", lambda *_: (True, 1))
    result = solve(disconnected, SETTINGS)
    assert not result.solved
    assert result.reason == Reason.REJECTED
    assert len(result.path) == 0


@pytest.mark.parametrize(
    ("ends", "reason"),
    [
        ({"start": (np.pi / 2, 0.0)}, Reason.START_COLLIDES),
        ({"goal": (np.pi / 2, 0.0)}, Reason.GOAL_COLLIDES),
    ],
)
def test_an_end_in_collision_is_named(make_problem, ends, reason):
    result = solve(make_problem([(0.0, 3.0)], **ends), SETTINGS)
    assert not result.solved
    assert result.reason == reason


@pytest.mark.parametrize(
    "samples",
    [np.zeros((4, 3)), np.zeros(4), [[np.nan, 0.0]], [[np.inf, 0.0]]],
    ids=["another robot's", "flat", "nan", "inf"],
)
def test_samples_that_do_not_fit_are_an_error(blocked, samples):
    with pytest.raises(PlanningError, match="samples do not fit"):
        solve(blocked, SETTINGS, samples)


def test_samples_for_a_planner_that_takes_none_are_an_error(blocked):
    with pytest.raises(PlanningError, match="takes no learned samples"):
        solve(blocked, PlannerSettings("RRTConnect"), np.zeros((4, 2)))


def test_an_end_of_another_robot_is_an_error(make_problem):
    with pytest.raises(PlanningError, match="goal does not fit"):
        solve(make_problem(goal=(0.0, 0.0, 0.0)), SETTINGS)


@pytest.mark.parametrize("share", [-0.1, float("nan")])
def test_a_uniform_share_out_of_range_is_an_error(blocked, share):
    with pytest.raises(ConfigError, match="uniform_share"):
        solve(blocked, SETTINGS, np.zeros((4, 2)), share)


def test_an_empty_batch_is_as_good_as_none(blocked):
    empty, none = solve(blocked, SETTINGS, np.empty((0, 2))), solve(blocked, SETTINGS)
    assert np.array_equal(empty.path, none.path)


def test_an_error_in_a_callback_reaches_the_caller_and_the_next_solve_works(blocked, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(checks.KERNELS, "checked_edge", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            solve(blocked, SETTINGS)
    assert solve(blocked, SETTINGS).solved


def test_a_result_can_not_be_written_into(blocked):
    with pytest.raises(ValueError, match="read-only"):
        solve(blocked, SETTINGS).path[0, 0] = 1.0


def test_ompl_says_nothing(blocked, capfd):
    solve(blocked, SETTINGS)
    solve(blocked, SETTINGS, uniform_samples(20))
    assert capfd.readouterr() == ("", "")
