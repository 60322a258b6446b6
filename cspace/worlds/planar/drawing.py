"""Discs and arm on axes of matplotlib."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike, NDArray

from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.scene import Scenario


def draw_discs(axes: Any, scenario: Scenario, colour: str) -> None:
    """The discs, in the camera's frame."""
    for x_m, y_m, radius_m in scenario.disc_array:
        axes.add_patch(Circle((x_m, y_m), radius_m, facecolor=colour, edgecolor="none", zorder=1))
    left, right, bottom, top = scenario.camera.extent_m
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def draw_arm(axes: Any, robot: PlanarArm, configuration: ArrayLike, colour: str, order: int) -> None:
    """The links at a configuration (d,) rad."""
    for base, tip in pairwise(robot.joint_positions_m(configuration)[0]):
        outline = capsule_outline(base, tip, robot.half_width_m)
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
