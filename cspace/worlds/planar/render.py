"""Drawing: scenario -> RGB picture, anti-aliased by exact supersampling where an outline passes."""

import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit
from cspace.worlds.planar.scene import Scenario

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
