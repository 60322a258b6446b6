"""The workspace: discs, the arm at start and goal, and its poses along the path."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from cspace.worlds.planar.problems import Problem
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
    robot, camera = problem.scenario.robot, problem.scenario.camera
    for x_m, y_m, radius_m in problem.scenario.disc_array:
        axes.add_patch(Circle((x_m, y_m), radius_m, facecolor=palette.OBSTACLE, edgecolor="none", zorder=1))
    if len(path) > 1:
        _draw_sweep(axes, problem, path)
    for configuration, colour in ((problem.start, palette.START), (problem.goal, palette.GOAL)):
        joints_m = robot.joint_positions_m(configuration)[0]
        _draw_arm(axes, joints_m, robot.half_width_m, colour, 4)
        axes.plot(*joints_m[1:-1].T, "o", markersize=3, color="white", zorder=5)
    axes.plot(0.0, 0.0, "o", markersize=7, color=palette.INK, zorder=6)
    axes.set_xlim(camera.x_min_m, camera.x_max_m)
    axes.set_ylim(camera.y_min_m, camera.y_max_m)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title("workspace")


def _draw_sweep(axes: Any, problem: Problem, path: NDArray[np.float64]) -> None:
    robot = problem.scenario.robot
    shares = np.linspace(0.0, 1.0, POSES + 2)[1:-1]
    poses = robot.joint_positions_m(poses_along(robot.space, path, POSES + 2))[1:-1]
    for share, joints_m in zip(shares, poses, strict=True):
        _draw_arm(axes, joints_m, robot.half_width_m, palette.between(share, 0.72), 2)
    tips = robot.joint_positions_m(poses_along(robot.space, path, _TRACE_POINTS))[:, -1]
    axes.plot(*tips.T, color=palette.PATH, linewidth=1.8, zorder=3)


def _draw_arm(axes: Any, joints_m: NDArray[np.float64], half_width_m: float, colour: str, order: int) -> None:
    for base, tip in pairwise(joints_m):
        outline = capsule_outline(base, tip, half_width_m)
        axes.add_patch(
            Polygon(outline, closed=True, facecolor=colour, edgecolor="white", linewidth=0.4, zorder=order)
        )


def capsule_outline(
    base: NDArray[np.float64], tip: NDArray[np.float64], half_width_m: float, points: int = 12
) -> NDArray[np.float64]:
    """The outline of a capsule between two points (2,), (2 points, 2) m."""
    heading = np.arctan2(tip[1] - base[1], tip[0] - base[0])
    turn = np.linspace(-np.pi / 2.0, np.pi / 2.0, points)
    round_tip = np.stack([np.cos(heading + turn), np.sin(heading + turn)], axis=-1)
    return np.concatenate([tip + half_width_m * round_tip, base - half_width_m * round_tip])
