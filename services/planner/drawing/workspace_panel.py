"""The workspace: obstacles, the robot at start and goal, and its poses along the path."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.simulator import Problem
from cspace.worlds import simulator_of
from services.planner.drawing import palette
from services.planner.drawing.wrapping import poses_along

POSES = 16
_TRACE_POINTS = 400


def draw_workspace(axes: Any, problem: Problem, path: NDArray[np.float64]) -> None:
    """Draw a problem's workspace and, where there is one, the sweep of a path.

    Args:
        axes: of matplotlib.
        problem: scenario, start and goal.
        path: (k, d) rad; (0, d) for none.
    """
    simulator = simulator_of(problem.scenario.world)
    body = simulator.world.body
    simulator.draw_scene(axes, problem.scenario, palette.OBSTACLE)
    if len(path) > 1:
        shares = np.linspace(0.0, 1.0, POSES + 2)[1:-1]
        poses = poses_along(problem.space, path, POSES + 2)[1:-1]
        for share, configuration in zip(shares, poses, strict=True):
            simulator.draw_robot(axes, configuration, palette.between(share, 0.72), 2)
        tips = body.joint_positions_m(poses_along(problem.space, path, _TRACE_POINTS))[:, -1]
        axes.plot(*tips.T, color=palette.PATH, linewidth=1.8, zorder=3)
    for configuration, colour in ((problem.start, palette.START), (problem.goal, palette.GOAL)):
        simulator.draw_robot(axes, configuration, colour, 4)
        axes.plot(
            *body.joint_positions_m(configuration)[0][1:-1].T, "o", markersize=3, color="white", zorder=5
        )
    axes.plot(0.0, 0.0, "o", markersize=7, color=palette.INK, zorder=6)
    axes.set_title("workspace")
