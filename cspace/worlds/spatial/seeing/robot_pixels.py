"""Which pixels of a depth picture show the arm, by where it stands. Numpy alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ImageError
from cspace.world import Between
from cspace.worlds.spatial.seeing.camera import DepthCamera

SLACK_M = 0.02
# Nearer than this a sphere's window is the whole picture.
_NEAR_M = 0.01
# Rays that are intersected at once, in some ms.
_AT_ONCE = 60_000


@dataclass(frozen=True, slots=True, eq=False)
class WithoutRobot:
    """A depth picture without the arm.

    Args:
        depth_mm: (H, W) uint16, the readings of other things; 0 where there is none.
        front_m: (H, W) float32, depth at which the arm and its slack begin where a pixel is the arm's;
            inf elsewhere. Up to there the pixel's ray was free.
    """

    depth_mm: NDArray[np.uint16]
    front_m: NDArray[np.float32]


def drop_robot(
    depth_mm: NDArray[np.uint16],
    camera: DepthCamera,
    spheres: ArrayLike,
    slack_m: float = SLACK_M,
    between: Between = lambda: None,
) -> WithoutRobot:
    """Take the arm out of a depth picture.

    A pixel is the arm's where its ray meets a sphere with its slack and its reading is not before that. Slack
    covers what noise and calibration are off by, both along the ray and across it.

    Args:
        depth_mm: (H, W) uint16 mm, 0 = no reading.
        camera: of the picture.
        spheres: (S, 4) that cover the arm as it stands: x, y, z, radius in m in the base frame.
        slack_m: added to every radius.
        between: called between parts of some ms; what it raises passes through.

    Raises:
        ImageError: the picture has another shape than the camera's.
    """
    check_picture(depth_mm, camera)
    begins = _begins_m(camera, np.asarray(spheres, dtype=np.float64).reshape(-1, 4), slack_m, between)
    shown = (depth_mm > 0) & (depth_mm * np.float32(1e-3) >= begins)
    return WithoutRobot(np.where(shown, np.uint16(0), depth_mm), np.where(shown, begins, np.float32(np.inf)))


def check_picture(depth_mm: NDArray[np.uint16], camera: DepthCamera) -> None:
    """Refuse what is no depth picture of a camera.

    Raises:
        ImageError: it has another shape than the camera's, or is not uint16.
    """
    if depth_mm.shape != camera.picture_shape or depth_mm.dtype != np.uint16:
        raise ImageError(
            "the depth picture does not fit the camera",
            expected=f"{camera.width} x {camera.height} pixels, uint16",
            got=f"an array of shape {depth_mm.shape}, {depth_mm.dtype}",
        )


def _begins_m(
    camera: DepthCamera, spheres: NDArray[np.float64], slack_m: float, between: Between
) -> NDArray[np.float32]:
    """Depth (H, W) at which the first of the spheres begins, inf beside all; 0 for a camera within one."""
    pose = camera.matrix
    centres = (spheres[:, :3] - pose[:3, 3]) @ pose[:3, :3]
    radii = spheres[:, 3] + slack_m
    first, last, top, bottom = _windows(camera, centres, radii)
    wide, high = np.maximum(last - first + 1, 0), np.maximum(bottom - top + 1, 0)
    sizes = np.where(centres[:, 2] + radii > 0.0, wide * high, 0)
    found = np.full(camera.width * camera.height, np.inf, dtype=np.float32)
    turns = np.cumsum(sizes) // _AT_ONCE
    for number in np.unique(turns[sizes > 0]):
        some = np.flatnonzero((turns == number) & (sizes > 0))
        count = sizes[some]
        own = np.repeat(some, count)
        place = np.arange(len(own)) - np.repeat(np.cumsum(count) - count, count)
        down, across = np.divmod(place, wide[own])
        rows, columns = top[own] + down, first[own] + across
        depth = _entry_m(
            (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, centres[own], radii[own]
        )
        np.minimum.at(found, rows * camera.width + columns, depth.astype(np.float32))
        between()
    return found.reshape(camera.picture_shape)


def _windows(
    camera: DepthCamera, centres: NDArray[np.float64], radii: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """First column, last, first row, last, each (S,), of the pixels that can show each sphere."""
    depth = centres[:, 2]
    ahead = depth - radii > _NEAR_M
    near, far = np.where(ahead, depth - radii, 1.0), np.where(ahead, depth + radii, 1.0)
    found = []
    for axis, focal, middle, side in (
        (0, camera.fx, camera.cx, camera.width),
        (1, camera.fy, camera.cy, camera.height),
    ):
        low, high = centres[:, axis] - radii, centres[:, axis] + radii
        least = np.where(ahead, focal * np.minimum(low / near, low / far) + middle, 0.0)
        most = np.where(ahead, focal * np.maximum(high / near, high / far) + middle, side - 1.0)
        found.append(np.ceil(np.clip(least, 0.0, side)).astype(np.int64))
        found.append(np.floor(np.clip(most, -1.0, side - 1.0)).astype(np.int64))
    return found[0], found[1], found[2], found[3]


def _entry_m(
    x: NDArray[np.float64], y: NDArray[np.float64], centres: NDArray[np.float64], radii: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Depth at which rays (x, y, 1) enter spheres, one each; inf beside them and for those behind."""
    square = x * x + y * y + 1.0
    middle = centres[:, 0] * x + centres[:, 1] * y + centres[:, 2]
    outside = np.einsum("nk,nk->n", centres, centres) - radii * radii
    inside = middle * middle - square * outside
    root = np.sqrt(np.maximum(inside, 0.0))
    met = (inside >= 0.0) & (middle + root > 0.0)
    return np.where(met, np.maximum((middle - root) / square, 0.0), np.inf)
