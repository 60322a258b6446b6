"""What a depth picture says of the space in view: what is free, and how deep the rest lies. Numpy alone."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.seeing.camera import DepthCamera
from cspace.worlds.spatial.seeing.grid_box import GridBox

FREE, NO_READING, OUT_OF_VIEW = 0, 254, 255
MOST_BEHIND = 253
BEHIND_STEP_M = 0.01
# A voxel is free if its centre is at least so far before the reading.
FREE_MARGIN_M = 0.015
# Nearer than this to a camera nothing is in view.
_NEAR_M = 0.02
# Of the neighbourhood of a pixel, pixels to each side.
_MAX_REACH = 8


def sight(
    surface_m: NDArray[np.float32],
    front_m: NDArray[np.float32],
    camera: DepthCamera,
    grid: GridBox,
    *,
    arm_hides: bool = True,
) -> NDArray[np.uint8]:
    """The codes of all voxels, (X, Y, Z).

    :data:`FREE`; 1 to :data:`MOST_BEHIND` for at most so many :data:`BEHIND_STEP_M` behind what the pixel
    shows, a surface or the arm, along its ray; :data:`NO_READING`; :data:`OUT_OF_VIEW`.

    Args:
        surface_m: (H, W) depth of surfaces, 0 = none.
        front_m: (H, W) depth up to which the ray of a pixel without a surface was free, inf = not known.
        camera: of the picture.
        grid: of the voxels.
        arm_hides: False tells what lies behind the arm as :data:`NO_READING`.
    """
    codes = np.full(int(np.prod(grid.counts)), OUT_OF_VIEW, dtype=np.uint8)
    voxels, column, row, depth = _in_view(camera, grid)
    if not len(voxels):
        return codes.reshape(grid.counts)
    footprint = np.float32(0.5 * max(camera.fx, camera.fy) * grid.voxel_m) / depth + np.float32(0.5)
    reach = int(min(footprint.max(), _MAX_REACH))
    layer = np.minimum(footprint, np.float32(reach)).astype(np.int32)
    pixel = row * np.int32(camera.width) + column
    limit = _limits(surface_m, front_m, reach).ravel()[layer * np.int32(camera.width * camera.height) + pixel]
    found = np.full(len(voxels), FREE, dtype=np.uint8)
    hidden = np.flatnonzero(depth > np.abs(limit) - np.float32(FREE_MARGIN_M))
    limit, pixel = limit[hidden], pixel[hidden]
    rays = np.linalg.norm(camera.rays(), axis=2).astype(np.float32).ravel() / np.float32(BEHIND_STEP_M)
    deep = np.clip((depth[hidden] - np.abs(limit)) * rays[pixel], 0.0, MOST_BEHIND - 1.0)
    known = limit != 0.0 if arm_hides else limit > 0.0
    found[hidden] = np.where(known, deep.astype(np.uint8) + np.uint8(1), np.uint8(NO_READING))
    codes[voxels] = found
    return codes.reshape(grid.counts)


def _limits(surface_m: NDArray[np.float32], front_m: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Up to where rays are free, (reach + 1, H, W), the nearest within so many pixels, from 0.

    Below 0 where no surface is what is in the way, and 0 where nothing is known.
    """
    read, robot = surface_m > 0, np.isfinite(front_m)
    surfaces = np.where(read, surface_m, np.float32(np.inf))
    fronts = np.minimum(surfaces, front_m)
    layers = []
    for number in range(reach + 1):
        if number:
            surfaces, fronts = _widened(surfaces), _widened(fronts)
        layers.append(np.where(read, surfaces, np.where(robot, -fronts, np.float32(0.0))))
    return np.stack(layers)


def _widened(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The least of each pixel and its eight neighbours."""
    wide = np.pad(depth, 1, constant_values=np.inf)
    rows = np.minimum(np.minimum(wide[:-2], wide[1:-1]), wide[2:])
    return np.asarray(np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:]))


def _in_view(
    camera: DepthCamera, grid: GridBox
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Numbers of the voxels whose centres are in view, columns and rows of their pixels, depths in m."""
    # Column and row times depth, and depth, are linear along each axis of the grid.
    pose = camera.matrix
    edges = np.array([[camera.fx, 0.0, camera.cx + 0.5], [0.0, camera.fy, camera.cy + 0.5], [0.0, 0.0, 1.0]])
    into = edges @ pose[:3, :3].T
    slopes = into * grid.voxel_m
    first = into @ (np.array(grid.low_m) + 0.5 * grid.voxel_m - pose[:3, 3])
    x, y, z = (np.arange(count) for count in grid.counts)
    starts = (
        first[:, None, None] + slopes[:, 0, None, None] * x[:, None] + slopes[:, 1, None, None] * y
    ).reshape(3, -1)
    low, high = _span(starts, slopes[:, 2], camera, len(z))
    count = np.maximum(high - low + 1, 0)
    above = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - low, count)
    voxels = above + np.repeat(np.arange(len(count)) * len(z), count)
    steps = above.astype(np.float32)
    forms = [
        np.repeat(start, count) + steps * slope
        for start, slope in zip(starts.astype(np.float32), slopes[:, 2].astype(np.float32), strict=True)
    ]
    inverse = np.float32(1.0) / forms[2]
    column = np.clip((forms[0] * inverse).astype(np.int32), 0, camera.width - 1)
    row = np.clip((forms[1] * inverse).astype(np.int32), 0, camera.height - 1)
    return voxels, column, row, forms[2]


def _span(
    starts: NDArray[np.float64], slopes: NDArray[np.float64], camera: DepthCamera, count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last z, each (X Y,), of each column of voxels that are in view; none: last < first."""
    low, high = np.zeros(starts.shape[1]), np.full(starts.shape[1], count - 1.0)
    column, row, depth = starts
    for at, by in (
        (column, slopes[0]),
        (camera.width * depth - column, camera.width * slopes[2] - slopes[0]),
        (row, slopes[1]),
        (camera.height * depth - row, camera.height * slopes[2] - slopes[1]),
        (depth - _NEAR_M, slopes[2]),
    ):
        if by > 0.0:
            low = np.maximum(low, np.ceil(-at / by))
        elif by < 0.0:
            high = np.minimum(high, np.floor(-at / by))
        else:
            high = np.where(at >= 0.0, high, -1.0)
    return np.minimum(low, count).astype(np.int64), np.maximum(high, -1.0).astype(np.int64)
