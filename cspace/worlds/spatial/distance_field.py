"""Surfaces that a depth picture shows, as small patches, and distances to them from voxels. NumPy alone."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.sensor import DISTANCE_STEP_M, FARTHEST, GridBox

# Of the distances; what is farther is as far as this.
TRUNCATION_M = FARTHEST * DISTANCE_STEP_M
# One patch is kept in each cell of this size.
CELL_M = 0.01
# Neighbours whose depths differ by less are on one surface; at more than a metre that share of the depth.
JUMP_M = 0.006
# Steeper ones are, up to the next bound, if inverse depth, linear over a plane, goes on likewise both ways.
_BEND = 0.25
_STEEPEST_M = 0.15
# Patches of near things go at least so far towards neighbours, for some are thinned away between them.
_LEAST_HALF_M = 0.005
# Patches that are longer are halved, so often at most.
_LONG_M = 0.02
_HALVINGS = 2
# Up to this distance patches are patches, beyond it points.
_PATCH_M = 0.05
_ID_BITS = 16
_AT_ONCE = 1 << _ID_BITS
_NONE = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Pieces of surface in units of a grid's voxels from its lowest corner, all float32."""

    points: NDArray[np.float32]  # (3, N) their middles
    sides: NDArray[np.float32]  # (2, 3, N) steps to the next pixel across and down
    ranges: NDArray[np.float32]  # (2, 2, N) least and greatest multiple of each step

    def chosen(self, numbers: NDArray[np.int64] | slice) -> "Patches":
        return Patches(self.points[:, numbers], self.sides[:, :, numbers], self.ranges[:, :, numbers])


def patches(depth_m: NDArray[np.float32], camera: DepthCamera, grid: GridBox) -> Patches:
    """Those of a depth picture (H, W) m, 0 = no reading, that a voxel of the grid is near to."""
    points = _points(depth_m, camera, grid)
    steps, ranges = zip(*(_steps(depth_m, points, axis, grid.voxel_m) for axis in (2, 1)), strict=True)
    edge = TRUNCATION_M / grid.voxel_m
    flat = points.reshape(3, -1)
    kept = np.flatnonzero((depth_m.ravel() > 0) & _is_near(flat, grid, edge))
    found = Patches(
        flat[:, kept],
        np.stack(steps).reshape(2, 3, -1)[:, :, kept],
        np.stack(ranges).reshape(2, 2, -1)[:, :, kept],
    )
    for _ in range(_HALVINGS):
        for axis in (0, 1):
            found = _halved(found, axis, _LONG_M / grid.voxel_m)
    found = found.chosen(np.flatnonzero(_is_near(found.points, grid, edge)))
    return found.chosen(_firsts(found.points, grid.voxel_m / CELL_M, edge))


def distance_codes(found: Patches, grid: GridBox) -> NDArray[np.uint8]:
    """From each voxel's centre to the nearest patch, (X, Y, Z), in :data:`DISTANCE_STEP_M`, rounded."""
    codes = np.full(grid.counts, FARTHEST, dtype=np.uint8)
    for first in range(0, found.points.shape[1], _AT_ONCE):
        some = found.chosen(slice(first, first + _AT_ONCE))
        np.minimum(codes, _codes(some, grid), out=codes)
    return codes


def _codes(found: Patches, grid: GridBox) -> NDArray[np.uint8]:
    """The same of so few patches that their numbers have room in a key."""
    codes = np.full(int(np.prod(grid.counts)), FARTHEST, dtype=np.uint8)
    limit = TRUNCATION_M / grid.voxel_m
    # Room on each side for cells beside the grid, and for voxels beside those.
    room = 2 * _pad(limit)
    nearest = np.full([count + 2 * room for count in grid.counts], _NONE)
    scale = np.float32((1 << (32 - _ID_BITS)) - 1) / np.float32((limit + 2.0) ** 2)
    _spread(nearest, found.points, limit, scale)
    inner = tuple(slice(room, -room) for _ in range(3))
    keys = nearest[inner].ravel()
    reached = np.flatnonzero(keys != _NONE)
    key = keys[reached]
    away = np.sqrt((key >> _ID_BITS) / scale)
    near = np.flatnonzero(away < _PATCH_M / grid.voxel_m)
    voxels = np.stack(np.unravel_index(reached[near], grid.counts)).astype(np.float32) + np.float32(0.5)
    away[near] = _to_patches(found, key[near] & np.uint32((1 << _ID_BITS) - 1), voxels)
    away *= np.float32(grid.voxel_m / DISTANCE_STEP_M)
    codes[reached] = np.minimum(np.rint(away), FARTHEST)
    return codes.reshape(grid.counts)


def _is_near(points: NDArray[np.float32], grid: GridBox, edge: float) -> NDArray[np.bool_]:
    """Which of the points (3, N) lie in the grid or less than so much beside it."""
    counts = np.array(grid.counts, dtype=np.float32)[:, None]
    return np.asarray(((points > -edge) & (points < counts + np.float32(edge))).all(axis=0))


def _halved(found: Patches, axis: int, longest: float) -> Patches:
    """With two halves for each patch that is longer than that along a side."""
    low, high = found.ranges[axis]
    step = found.sides[axis]
    size = np.sqrt((step * step).sum(axis=0)) * (high - low)
    cut = np.flatnonzero(size > longest)
    if not len(cut):
        return found
    halves = [found.chosen(np.flatnonzero(size <= longest))]
    for least, most in ((low, (low + high) * 0.5), ((low + high) * 0.5, high)):
        half = found.chosen(cut)
        middle, reach = (least + most)[cut] * np.float32(0.5), (most - least)[cut] * np.float32(0.5)
        half.ranges[axis] = -reach, reach
        halves.append(Patches(half.points + step[:, cut] * middle, half.sides, half.ranges))
    return Patches(
        np.concatenate([one.points for one in halves], axis=1),
        np.concatenate([one.sides for one in halves], axis=2),
        np.concatenate([one.ranges for one in halves], axis=2),
    )


def _points(depth_m: NDArray[np.float32], camera: DepthCamera, grid: GridBox) -> NDArray[np.float32]:
    """Back-projection in the grid's units, (3, H, W)."""
    pose = camera.matrix
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    turn = (pose[:3, :3] / grid.voxel_m).astype(np.float32)[:, :, None, None]
    place = ((pose[:3, 3] - np.array(grid.low_m)) / grid.voxel_m).astype(np.float32)
    rays = turn[:, 0] * x.astype(np.float32) + turn[:, 1] * y.astype(np.float32)[:, None] + turn[:, 2]
    return np.asarray(rays * depth_m + place[:, None, None])


def _steps(
    depth_m: NDArray[np.float32], points: NDArray[np.float32], axis: int, voxel_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Along an axis of the points: the step (3, H, W) to the next pixel, and its multiples (2, H, W)."""
    one = np.diff(points, axis=axis)
    linked = _linked(depth_m, axis - 1)
    one *= linked
    wide = [(0, 0)] * 3
    wide[axis] = (1, 1)
    beside = np.pad(one, wide)
    joined = np.pad(linked.astype(np.float32), wide[1:])
    length = points.shape[axis]
    before, after = (
        np.take(joined, range(length), axis - 1),
        np.take(joined, range(1, length + 1), axis - 1),
    )
    total = np.take(beside, range(length), axis) + np.take(beside, range(1, length + 1), axis)
    step = total / np.maximum(before + after, np.float32(1.0))
    size = np.sqrt((step * step).sum(axis=0)) * np.float32(voxel_m)
    half = np.maximum(np.float32(0.5), np.float32(_LEAST_HALF_M) / np.maximum(size, np.float32(1e-6)))
    return step, np.stack((-half * before, half * after))


def _linked(depth_m: NDArray[np.float32], axis: int) -> NDArray[np.bool_]:
    """Which neighbours along an axis of (H, W) are on one surface, one less along it."""
    depth = np.moveaxis(depth_m, axis, 0)
    read = depth > 0
    both = read[1:] & read[:-1]
    gap = np.abs(depth[1:] - depth[:-1])
    level = gap <= np.float32(JUMP_M) * np.maximum(np.minimum(depth[1:], depth[:-1]), np.float32(1.0))
    inverse = np.divide(np.float32(1.0), depth, out=np.zeros_like(depth), where=read)
    slope = np.diff(inverse, axis=0)
    bend = np.full((len(slope) + 1, *slope.shape[1:]), np.inf, dtype=np.float32)
    # A neighbour that reads nothing has no slope to go on with.
    known = both[1:] & both[:-1]
    bend[1:-1] = np.where(known, np.abs(np.diff(slope, axis=0)), np.inf)
    steady = np.maximum(bend[1:], bend[:-1]) <= np.float32(_BEND) * np.abs(slope)
    return np.moveaxis(both & (level | (steady & (gap <= np.float32(_STEEPEST_M)))), 0, axis)


def _firsts(points: NDArray[np.float32], cells: float, edge: float) -> NDArray[np.int64]:
    """One of the points (3, N) of each cell, of which so many are in a voxel's side."""
    cell = np.floor((points + np.float32(edge)) * np.float32(cells)).astype(np.int64)
    key = (cell[0] << 40) + (cell[1] << 20) + cell[2]
    order = np.argsort(key)
    key = key[order]
    return np.asarray(order[np.concatenate((np.ones(min(len(key), 1), dtype=bool), key[1:] != key[:-1]))])


def _spread(
    nearest: NDArray[np.uint32], points: NDArray[np.float32], limit: float, scale: np.float32
) -> None:
    """Let every voxel have the least key near it: squared distance in the upper bits, number in the lower."""
    pad = _pad(limit)
    cell = np.floor(points).astype(np.int64)
    inside = points - cell
    offsets = np.arange(-pad, pad + 1, dtype=np.float32)[:, None]
    squares = [
        np.rint((offsets + np.float32(0.5) - inside[axis]) ** 2 * scale).astype(np.uint32) << _ID_BITS
        for axis in range(3)
    ]
    numbers = np.arange(points.shape[1], dtype=np.uint32)
    flat, (_, across, up) = nearest.reshape(-1), nearest.shape
    x, y, z = cell + 2 * pad
    start = (x * across + y) * up + z
    for x, y, reach in _runs(limit):
        key = squares[2][pad - reach : pad + reach + 1] + (
            squares[0][x + pad] + squares[1][y + pad] + numbers
        )
        index = start + (np.arange(-reach, reach + 1) + (x * across + y) * up)[:, None]
        np.minimum.at(flat, index.ravel(), key.ravel())


def _pad(limit: float) -> int:
    """How many cells away a point can be that is so near to a voxel's centre."""
    return int(np.ceil(limit + 0.5))


@lru_cache(maxsize=8)
def _runs(limit: float) -> tuple[tuple[int, int, int], ...]:
    """Offsets x, y and largest z of the cells whose nearest point is so near to a voxel's centre."""
    pad = _pad(limit)
    squares = np.maximum(np.abs(np.arange(-pad, pad + 1)) - 0.5, 0.0) ** 2
    counts = (squares[:, None, None] + squares[:, None] + squares <= limit * limit).sum(axis=2)
    return tuple((x - pad, y - pad, int(counts[x, y] // 2)) for x, y in np.argwhere(counts).tolist())


def _to_patches(
    found: Patches, numbers: NDArray[np.uint32], voxels: NDArray[np.float32]
) -> NDArray[np.float32]:
    """From each of the points (3, M) to the patch of a number, (M,)."""
    gap = voxels - found.points[:, numbers]
    across, down = found.sides[0][:, numbers], found.sides[1][:, numbers]
    (least_a, most_a), (least_d, most_d) = found.ranges[0][:, numbers], found.ranges[1][:, numbers]
    aa, dd, ad = (across * across).sum(0), (down * down).sum(0), (across * down).sum(0)
    ga, gd = (gap * across).sum(0), (gap * down).sum(0)
    tiny = np.float32(1e-9)
    whole = np.maximum(aa * dd - ad * ad, tiny)
    a = np.clip((ga * dd - gd * ad) / whole, least_a, most_a)
    # The best of one side for the other as it was clipped, and the other way round.
    d = np.clip((gd - a * ad) / np.maximum(dd, tiny), least_d, most_d)
    a = np.clip((ga - d * ad) / np.maximum(aa, tiny), least_a, most_a)
    left = gap - a * across - d * down
    return np.asarray(np.sqrt((left * left).sum(0)))
