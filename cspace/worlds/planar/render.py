"""Renders a scenario as an RGB picture, and draws it on axes of matplotlib."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import Scenario

SUBSAMPLES = 8
WHITE = (255, 255, 255)
DISC_COLOUR = (255, 0, 0)
ARM_COLOUR = (0, 0, 255)


@njit(cache=True, nogil=True)
def _signed_distances(x, y, joints, half_width, discs):  # type: ignore[no-untyped-def]
    to_disc = np.inf
    for disc in range(discs.shape[0]):
        gap = np.hypot(x - discs[disc, 0], y - discs[disc, 1]) - discs[disc, 2]
        to_disc = min(to_disc, gap)
    to_arm = np.inf
    for link in range(joints.shape[0] - 1):
        dx, dy = joints[link + 1, 0] - joints[link, 0], joints[link + 1, 1] - joints[link, 1]
        px, py = x - joints[link, 0], y - joints[link, 1]
        along = min(1.0, max(0.0, (px * dx + py * dy) / (dx * dx + dy * dy)))
        to_arm = min(to_arm, np.hypot(px - along * dx, py - along * dy) - half_width)
    return to_disc, to_arm


@njit(cache=True, nogil=True)
def _shares(x0, y1, width, height, joints, half_width, discs):  # type: ignore[no-untyped-def]
    """Shares of one pixel that discs and arm cover, the discs over the arm."""
    to_disc, to_arm = _signed_distances(x0 + width / 2, y1 - height / 2, joints, half_width, discs)
    reach = np.hypot(width, height) / 2
    if to_disc <= -reach:
        return 1.0, 0.0
    if to_disc >= reach and (to_arm >= reach or to_arm <= -reach):
        return 0.0, 1.0 if to_arm < 0 else 0.0
    in_disc, in_arm = 0, 0
    for row in range(SUBSAMPLES):
        for column in range(SUBSAMPLES):
            x = x0 + (column + 0.5) * width / SUBSAMPLES
            y = y1 - (row + 0.5) * height / SUBSAMPLES
            to_disc, to_arm = _signed_distances(x, y, joints, half_width, discs)
            if to_disc <= 0:
                in_disc += 1
            elif to_arm <= 0:
                in_arm += 1
    return in_disc / SUBSAMPLES**2, in_arm / SUBSAMPLES**2


@njit(cache=True, nogil=True)
def _draw(pixels, x_min, x_max, y_min, y_max, joints, half_width, discs):  # type: ignore[no-untyped-def]
    out = np.empty((pixels, pixels, 3), dtype=np.uint8)
    width, height = (x_max - x_min) / pixels, (y_max - y_min) / pixels
    for row in range(pixels):
        for column in range(pixels):
            disc, arm = _shares(
                x_min + column * width, y_max - row * height, width, height, joints, half_width, discs
            )
            for channel in range(3):
                value = (
                    disc * DISC_COLOUR[channel]
                    + arm * ARM_COLOUR[channel]
                    + (1 - disc - arm) * WHITE[channel]
                )
                out[row, column, channel] = np.uint8(np.floor(value + 0.5))
    return out


def render(scenario: Scenario) -> NDArray[np.uint8]:
    """The picture, (P, P, 3) uint8: red discs over the blue arm at angle zero, white ground, y up."""
    camera, robot = scenario.camera, scenario.robot
    joints = robot.joint_positions_m(np.zeros((1, robot.dim)))[0]
    picture: NDArray[np.uint8] = _draw(
        camera.pixels,
        camera.x_min_m,
        camera.x_max_m,
        camera.y_min_m,
        camera.y_max_m,
        joints,
        robot.half_width_m,
        scenario.disc_array,
    )
    return picture


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
