"""Planners of limited arms: no path and no tree goes round a joint that has limits."""

import numpy as np
import pytest

from cspace.simulator import Problem
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.free_grid import FINE_CELLS, FreeGrid, PathFinder
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import Scenario
from services.planner.ompl_planner import solve
from services.planner.result import Reason, check_path
from services.planner.settings import PlannerSettings

# Nearly a whole turn, beyond half a turn, and more than a turn.
ARMS = {
    "seam": PlanarArm(joint_limits_rad=((-3.1, 3.1), None)),
    "beyond": PlanarArm(joint_limits_rad=((-2.9, 4.0), (-4.0, 1.0))),
    "turns": PlanarArm(joint_limits_rad=((-7.0, 7.0), (-1.0, 1.0))),
}


def problem(name):
    """From near one limit of the first joint to near the other, without any disc."""
    robot = ARMS[name]
    (low, high), middle = (
        robot.joint_limits_rad[0],
        np.mean([robot.space.lower, robot.space.upper], axis=0)[1],
    )
    ends = np.array([[low + 0.1, middle], [high - 0.1, middle]])
    return Problem(Scenario(robot, ()), ends[0], ends[1], Family.UNIFORM, 1.0, 0, 0)


@pytest.fixture(params=list(ARMS))
def task(request):
    return problem(request.param)


@pytest.mark.parametrize(
    ("planner", "learned"),
    [
        ("RRTConnect", False),
        ("RRTstar", False),
        *((planner, True) for planner in ("RRT", "SampledRRTConnect", "PRM", "RRTstar")),
    ],
)
def test_paths_do_not_go_round_limited_joints(task, planner, learned):
    space = task.scenario.robot.space
    rows = space.sample_uniform(np.random.default_rng(1), 60) if learned else None
    settings = PlannerSettings(planner=planner, seed=3, range_rad=1.0, time_limit_s=20.0)
    result = solve(task, settings, rows, 0.5)
    assert result.reason == Reason.SOLVED
    assert space.contains(result.path).all()
    gone = space.difference(result.path[:-1], result.path[1:])[:, 0]
    assert gone.sum() == pytest.approx(task.goal[0] - task.start[0], abs=1e-5)
    np.testing.assert_allclose(np.diff(result.path[:, 0]), gone)
    assert check_path(task, result.path, settings.resolution_rad) == Reason.SOLVED
    assert result.length_rad >= task.goal[0] - task.start[0] - 1e-5


def test_samples_outside_the_limits_do_no_harm(task):
    space = task.scenario.robot.space
    rows = np.random.default_rng(2).uniform(-12.0, 12.0, (200, 2))
    result = solve(task, PlannerSettings(seed=3, time_limit_s=20.0), rows, 0.3)
    assert result.solved
    assert space.contains(result.path).all()


def test_grids_end_at_the_limits(task):
    path = PathFinder(task.scenario, cells=64).path(task.start, task.goal)
    np.testing.assert_allclose(path, np.stack([task.start, task.goal]))
    assert task.scenario.robot.space.contains(path).all()
    assert FreeGrid(task.scenario, FINE_CELLS).bottleneck_rad(task.start, task.goal) == np.inf
