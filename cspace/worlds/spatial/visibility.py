"""What depth pictures say of the space round an arm: self filter, visibility, fused grid. NumPy alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from cspace.worlds.spatial.camera import MIN_SIDE, DepthCamera, in_range, resize_depth, to_m
from cspace.worlds.spatial.distance_field import TRUNCATION_M, distance_codes, patches
from cspace.worlds.spatial.sensor import (
    BEHIND_STEP_M,
    DISTANCE_STEP_M,
    FREE,
    MOST_BEHIND,
    NO_READING,
    OUT_OF_VIEW,
    GridBox,
)

SLACK_M = 0.02
# Neighbours of a reading that share it, and how near they are to it: about what noise makes of one surface.
_ALIKE, _SAME_M, _SAME_PER_M = 2, 0.03, 0.01
# How many pixels from the arm's they may be.
_BESIDE_PX = 3
# Nearer than this a sphere's window is the whole picture.
_NEAREST_SPHERE_M = 0.01
# Rays that are intersected at once, in little memory.
_AT_ONCE = 60_000


@dataclass(frozen=True, slots=True, eq=False)
class WithoutRobot:
    """A depth picture without the arm."""

    depth_mm: NDArray[np.uint16]  # (H, W) uint16, the readings of other things; 0 where there is none
    front_m: NDArray[np.float32]  # (H, W), depth at which the arm begins in its pixels; inf elsewhere


def self_filter(
    depth_mm: NDArray[np.uint16],
    camera: DepthCamera,
    spheres: ArrayLike,
    slack_m: float = SLACK_M,
) -> WithoutRobot:
    """Take the arm, spheres (S, 4) m, out of a depth picture (H, W) uint16 mm, 0 = no reading.

    A pixel is the arm's where its ray meets a sphere with its slack and its reading is not before that.
    """
    begins = arm_depth_m(camera, np.asarray(spheres, dtype=np.float64).reshape(-1, 4), slack_m)
    shown = (depth_mm > 0) & (depth_mm * np.float32(1e-3) >= begins)
    return WithoutRobot(np.where(shown, np.uint16(0), depth_mm), np.where(shown, begins, np.float32(np.inf)))


def without_lone(surface_m: NDArray[np.float32], front_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Surfaces (H, W) m, 0 = none, without lone readings beside the arm, where cameras read flying pixels."""
    beside_arm = np.where(np.isfinite(front_m), np.float32(0.0), np.float32(np.inf))
    for _ in range(_BESIDE_PX):
        beside_arm = _widened(beside_arm)
    around = sliding_window_view(np.pad(surface_m, 1), (3, 3))
    near = np.float32(_SAME_M) + np.float32(_SAME_PER_M) * surface_m**2
    alike = (around > 0) & (np.abs(around - surface_m[..., None, None]) <= near[..., None, None])
    # A reading is like itself.
    lone = np.isfinite(beside_arm) & (alike.sum(axis=(2, 3)) <= _ALIKE)
    return np.where(lone, np.float32(0.0), surface_m)


def arm_depth_m(
    camera: DepthCamera,
    spheres: NDArray[np.float64],
    slack_m: float = 0.0,
) -> NDArray[np.float32]:
    """The arm as rendered: depth (H, W) m at which its first sphere of (S, 4) m begins, inf beside them."""
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
    return found.reshape(camera.picture_shape)


def _windows(
    camera: DepthCamera, centres: NDArray[np.float64], radii: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """First column, last, first row, last, each (S,), of the pixels that can show each sphere."""
    depth = centres[:, 2]
    ahead = depth - radii > _NEAREST_SPHERE_M
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
) -> NDArray[np.uint8]:
    """The codes of all voxels, (X, Y, Z), as :mod:`cspace.worlds.spatial.sensor` names them.

    ``surface_m``: (H, W), 0 = none. ``front_m``: (H, W) up to where the ray of a pixel without a surface was
    free, inf = not known.
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
    hidden = np.flatnonzero(depth > limit - np.float32(FREE_MARGIN_M))
    limit, pixel = limit[hidden], pixel[hidden]
    rays = np.linalg.norm(camera.rays(), axis=2).astype(np.float32).ravel() / np.float32(BEHIND_STEP_M)
    deep = np.clip((depth[hidden] - limit) * rays[pixel], 0.0, MOST_BEHIND - 1.0)
    found[hidden] = np.where(limit > 0.0, deep.astype(np.uint8) + np.uint8(1), np.uint8(NO_READING))
    codes[voxels] = found
    return codes.reshape(grid.counts)


def _limits(surface_m: NDArray[np.float32], front_m: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Up to where rays are free, the nearest within 0 to ``reach`` pixels, (reach + 1, H, W); 0 unknown."""
    read, robot = surface_m > 0, np.isfinite(front_m)
    surfaces = np.where(read, surface_m, np.float32(np.inf))
    fronts = np.minimum(surfaces, front_m)
    layers = []
    for number in range(reach + 1):
        if number:
            surfaces, fronts = _widened(surfaces), _widened(fronts)
        layers.append(np.where(read, surfaces, np.where(robot, fronts, np.float32(0.0))))
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


# Larger pictures are reduced to it, to the nearest readings of their cells.
MAX_USED_SIDE = 160


@dataclass(frozen=True, slots=True, eq=False)
class VoxelValues:
    """What an array says of points."""

    distance_m: NDArray[np.float32]  # (...) float32 to the nearest surface seen, at most :data:`TRUNCATION_M`
    codes: NDArray[np.uint8]  # (...) uint8, channel 1 of :func:`observe`

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """(...): no camera saw that it is free."""
        return np.asarray(self.codes != FREE)


def observe(
    picture: NDArray[np.uint16],
    camera: DepthCamera,
    grid: GridBox,
    spheres: ArrayLike | None = None,
    is_explained: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
) -> NDArray[np.uint8]:
    """What a depth picture (H, W) uint16 mm says of the space round an arm, (X, Y, Z, 2) uint8.

    Channel 0 is the distance from a voxel's centre to the nearest surface seen, channel 1 the code of
    :func:`sight`. ``spheres``: (S, 4) m that cover the arm; None where it is not in the picture.
    ``is_explained``: which surfaces (N, 3) m hide what is behind them and are none themselves.
    """
    smaller, camera = reduced(np.where(in_range(picture), picture, np.uint16(0)), camera)
    kept = self_filter(smaller, camera, np.empty((0, 4)) if spheres is None else spheres)
    surface_m = without_lone(to_m(kept.depth_mm), kept.front_m)
    shown_m = surface_m.copy()
    if is_explained is not None:
        read = surface_m > 0.0
        shown_m[read] *= ~is_explained(camera.points_m(surface_m)[read])
    away = distance_codes(patches(shown_m, camera, grid), grid)
    return np.stack((away, sight(surface_m, kept.front_m, camera, grid)), axis=-1)


def fused(single: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """What several pictures of one scene say together, each (X, Y, Z, 2): what one has seen free is free."""
    return np.asarray(np.minimum.reduce(list(single)))


def distances_m(observed: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Of an array (..., 2), (...) m; :data:`TRUNCATION_M` stands for all that is farther."""
    return np.asarray(observed[..., 0] * np.float32(DISTANCE_STEP_M))


def lookup(observed: NDArray[np.uint8], grid: GridBox, points_m: ArrayLike) -> VoxelValues:
    """What an array (X, Y, Z, 2) says of points (..., 3) m: distances trilinear, codes of the voxel."""
    points = np.asarray(points_m)
    place = ((points.reshape(-1, 3) - np.array(grid.low_m)) / grid.voxel_m).astype(np.float32).T
    inside = ((place >= 0.0) & (place < np.array(grid.counts, dtype=np.float32)[:, None])).all(axis=0)
    place = np.where(inside, place, np.float32(0.0))
    x, y, z = place.astype(np.intp)
    cell = (x * grid.counts[1] + y) * grid.counts[2] + z
    flat = observed.reshape(-1)
    codes = np.where(inside, flat.take(2 * cell + 1), np.uint8(OUT_OF_VIEW))
    low, share, steps = [], [], []
    for axis, count in enumerate(grid.counts):
        middle = np.clip(place[axis] - np.float32(0.5), 0.0, np.float32(count - 1))
        first = np.minimum(middle.astype(np.intp), max(count - 2, 0))
        low.append(first)
        share.append(middle - first.astype(np.float32))
        steps.append(1 if count > 1 else 0)
    strides = 2 * np.array((grid.counts[1] * grid.counts[2], grid.counts[2], 1))
    start = low[0] * strides[0] + low[1] * strides[1] + low[2] * strides[2]
    across, down, up = (int(one) for one in strides * steps)

    def along_z(at: int) -> NDArray[np.float32]:
        one = flat.take(start + at).astype(np.float32)
        return np.asarray(one + share[2] * (flat.take(start + (at + up)).astype(np.float32) - one))

    def along_y(at: int) -> NDArray[np.float32]:
        one = along_z(at)
        return np.asarray(one + share[1] * (along_z(at + down) - one))

    near = along_y(0)
    near = (near + share[0] * (along_y(across) - near)) * np.float32(DISTANCE_STEP_M)
    distance = np.where(inside, near, np.float32(TRUNCATION_M))
    shape = points.shape[:-1]
    return VoxelValues(distance.reshape(shape), codes.reshape(shape))


def reduced(picture: NDArray[np.uint16], camera: DepthCamera) -> tuple[NDArray[np.uint16], DepthCamera]:
    """A picture with no side above :data:`MAX_USED_SIDE`, and its camera; smaller ones as they are."""
    share = MAX_USED_SIDE / max(picture.shape)
    if share >= 1.0:
        return picture, camera
    height, width = (min(side, max(MIN_SIDE, int(side * share))) for side in picture.shape)
    smaller = resize_depth(picture, height, width)
    return smaller, camera.resized(width, height)
