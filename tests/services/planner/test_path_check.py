import numpy as np
import pytest

from services.planner.result import Reason, check_path


def test_a_free_path_from_start_to_goal_is_solved(blocked):
    path = np.stack([blocked.start, [-1.5, 0.0], blocked.goal])
    assert check_path(blocked, path, 0.03) is Reason.SOLVED


def test_an_edge_through_an_obstacle_is_rejected(make_problem):
    problem = make_problem([(0.0, 3.0)], goal=(3.0, 0.0))
    path = np.stack([problem.start, problem.goal])
    assert check_path(problem, path, 0.03) is Reason.REJECTED


def test_the_check_sees_what_the_planner_s_resolution_steps_over(make_problem):
    # The arm sweeps past a small disc at its tip: one coarse step jumps it, a tenth of that does not.
    problem = make_problem([(3.9, 0.0, 0.05)], (-0.2, 0.0), (0.2, 0.0))
    path = np.stack([problem.start, problem.goal])
    assert check_path(problem, path, 0.4) is Reason.REJECTED


@pytest.mark.parametrize("shift", [2e-6, 1.0])
def test_a_path_that_ends_beside_the_goal_is_not_a_solution(blocked, shift):
    path = np.stack([blocked.start, blocked.goal + np.array([0.0, shift])])
    assert check_path(blocked, path, 0.03) is Reason.WRONG_ENDS


def test_a_path_that_starts_elsewhere_or_is_a_single_state_is_not_a_solution(make_problem):
    problem = make_problem()
    assert check_path(problem, np.stack([[0.1, 0.0], problem.goal]), 0.03) is Reason.WRONG_ENDS
    assert check_path(problem, problem.goal[None], 0.03) is Reason.WRONG_ENDS
    assert check_path(problem, np.empty((0, 2)), 0.03) is Reason.WRONG_ENDS


def test_the_goal_may_be_written_with_another_turn(make_problem):
    problem = make_problem(goal=(-np.pi, 0.0))
    path = np.stack([problem.start, [np.pi - 1e-9, 0.0]])
    assert check_path(problem, path, 0.03) is Reason.SOLVED
