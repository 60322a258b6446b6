"""Signed distances, compiled: from points and spheres to boxes and cylinders, and on a grid of voxels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.worlds.spatial.obstacles import Obstacles


@njit(cache=True, nogil=True, error_model="numpy")
def _outside_and_in(one, two, three):  # type: ignore[no-untyped-def]
    """From how far a point is beyond each pair of faces, negative between them."""
    inside = min(max(one, two, three), 0.0)
    one, two, three = max(one, 0.0), max(two, 0.0), max(three, 0.0)
    return inside + np.sqrt(one * one + two * two + three * three)


@njit(cache=True, nogil=True, error_model="numpy")
def box_distance(x, y, z, row):  # type: ignore[no-untyped-def]
    """Of a point to a row of :class:`ObstacleArrays` ``boxes``, m."""
    px, py, pz = x - row[0], y - row[1], z - row[2]
    along_x = abs(row[3] * px + row[6] * py + row[9] * pz) - row[12]
    along_y = abs(row[4] * px + row[7] * py + row[10] * pz) - row[13]
    along_z = abs(row[5] * px + row[8] * py + row[11] * pz) - row[14]
    return _outside_and_in(along_x, along_y, along_z)


@njit(cache=True, nogil=True, error_model="numpy")
def cylinder_distance(x, y, z, row):  # type: ignore[no-untyped-def]
    """Of a point to a row of :class:`ObstacleArrays` ``cylinders``, m."""
    px, py, pz = x - row[0], y - row[1], z - row[2]
    along = row[5] * px + row[8] * py + row[11] * pz
    # Never below zero but by rounding.
    square = max(px * px + py * py + pz * pz - along * along, 0.0)
    return _outside_and_in(np.sqrt(square) - row[12], abs(along) - row[13], -np.inf)


@njit(cache=True, nogil=True, error_model="numpy")
def is_beyond(x, y, z, row, bound):  # type: ignore[no-untyped-def]
    """Whether the sphere round a shape is at least ``bound`` away, and so is the shape."""
    reach = bound + row[row.shape[0] - 1]
    px, py, pz = x - row[0], y - row[1], z - row[2]
    return reach < 0.0 or px * px + py * py + pz * pz >= reach * reach


@njit(cache=True, nogil=True, error_model="numpy")
def point_distance(x, y, z, boxes, cylinders, bound):  # type: ignore[no-untyped-def]
    """Least signed distance of a point to all obstacles, m, or ``bound`` where none is nearer."""
    for index in range(boxes.shape[0]):
        if not is_beyond(x, y, z, boxes[index], bound):
            bound = min(bound, box_distance(x, y, z, boxes[index]))
    for index in range(cylinders.shape[0]):
        if not is_beyond(x, y, z, cylinders[index], bound):
            bound = min(bound, cylinder_distance(x, y, z, cylinders[index]))
    return bound


@njit(cache=True, nogil=True, error_model="numpy")
def points_distance(points, boxes, cylinders):  # type: ignore[no-untyped-def]
    """Of points (N, 3) m, (N,) m; inf without obstacles."""
    out = np.empty(points.shape[0])
    for at in range(points.shape[0]):
        out[at] = point_distance(points[at, 0], points[at, 1], points[at, 2], boxes, cylinders, np.inf)
    return out


def distance_m(obstacles: Obstacles, points_m: ArrayLike) -> NDArray[np.float64]:
    """Signed distance of points (..., 3) m to the nearest obstacle, (...) m; inf where there is none."""
    points = np.asarray(points_m, dtype=np.float64)
    arrays = obstacles.arrays
    flat = np.ascontiguousarray(points.reshape(-1, 3))
    found: NDArray[np.float64] = points_distance(flat, arrays.boxes, arrays.cylinders)
    return found.reshape(points.shape[:-1])


def clearance_m(obstacles: Obstacles, centres_m: ArrayLike, radii_m: ArrayLike) -> NDArray[np.float64]:
    """Least clearance of sets of spheres, (N,) m: (N, S, 3) centres, (S,) radii; inf without obstacles."""
    return np.asarray((distance_m(obstacles, centres_m) - np.asarray(radii_m)).min(axis=1, initial=np.inf))


class DistanceGrid(NamedTuple):
    """Signed distances at the centres of voxels, as the kernels take them."""

    values: NDArray[np.float32]  # (X, Y, Z) m, cut off at `farthest`; nothing without voxels
    low: NDArray[np.float64]  # (3,) lowest corner in the base frame, m
    voxel: float  # side of a voxel, m
    farthest: float  # what stands for all that is farther away, m


NOTHING = DistanceGrid(np.empty((0, 0, 0), dtype=np.float32), np.zeros(3), 1.0, 0.0)


def distance_grid(values: NDArray[np.float32], low_m: ArrayLike, voxel_m: float) -> DistanceGrid:
    """Distances (X, Y, Z) m at the centres of voxels, from a lowest corner (3,) m on."""
    held = np.ascontiguousarray(values, dtype=np.float32)
    return DistanceGrid(held, np.asarray(low_m, dtype=np.float64), float(voxel_m), float(held.max()))


@njit(cache=True, nogil=True, error_model="numpy")
def grid_distance(x, y, z, grid):  # type: ignore[no-untyped-def]
    """At a point of the base frame, trilinear between the centres of voxels, m; outside ``farthest``."""
    values, voxel = grid.values, grid.voxel
    u, v, w = (x - grid.low[0]) / voxel, (y - grid.low[1]) / voxel, (z - grid.low[2]) / voxel
    if u < 0.0 or v < 0.0 or w < 0.0:
        return grid.farthest
    if u >= values.shape[0] or v >= values.shape[1] or w >= values.shape[2]:
        return grid.farthest
    u = min(max(u - 0.5, 0.0), values.shape[0] - 1.001)
    v = min(max(v - 0.5, 0.0), values.shape[1] - 1.001)
    w = min(max(w - 0.5, 0.0), values.shape[2] - 1.001)
    i, j, k = int(u), int(v), int(w)
    u, v, w = u - i, v - j, w - k
    low = _lerp(values[i, j, k], values[i, j, k + 1], w)
    low += v * (_lerp(values[i, j + 1, k], values[i, j + 1, k + 1], w) - low)
    high = _lerp(values[i + 1, j, k], values[i + 1, j, k + 1], w)
    high += v * (_lerp(values[i + 1, j + 1, k], values[i + 1, j + 1, k + 1], w) - high)
    return low + u * (high - low)


@njit(cache=True, nogil=True, error_model="numpy")
def _lerp(first, second, share):  # type: ignore[no-untyped-def]
    return first + share * (second - first)


@njit(cache=True, nogil=True, error_model="numpy")
def make_room(grid, centres, radii, slack, plateau, slope):  # type: ignore[no-untyped-def]
    """Raise distances, in place, so that spheres (S, 3), (S,) m just fit where they are known to be free.

    Each sphere gets what it lacks and ``slack`` m, within ``plateau`` m of its centre; farther away ``slope``
    less for each metre.
    """
    values, voxel = grid.values, grid.voxel
    raised = np.zeros_like(values)
    for at in range(centres.shape[0]):
        lacks = radii[at] - grid_distance(centres[at, 0], centres[at, 1], centres[at, 2], grid)
        if lacks < 0.0:
            continue
        most = lacks + slack
        reach = plateau + most / slope
        first, last = np.empty(3, np.int64), np.empty(3, np.int64)
        for axis in range(3):
            low = (centres[at, axis] - reach - grid.low[axis]) / voxel - 0.5
            first[axis] = max(0, int(np.ceil(low)))
            last[axis] = min(values.shape[axis] - 1, int(np.floor(low + 2.0 * reach / voxel)))
        for i in range(first[0], last[0] + 1):
            x = grid.low[0] + (i + 0.5) * voxel - centres[at, 0]
            for j in range(first[1], last[1] + 1):
                y = grid.low[1] + (j + 0.5) * voxel - centres[at, 1]
                for k in range(first[2], last[2] + 1):
                    z = grid.low[2] + (k + 0.5) * voxel - centres[at, 2]
                    beyond = max(np.sqrt(x * x + y * y + z * z) - plateau, 0.0)
                    raised[i, j, k] = max(raised[i, j, k], most - slope * beyond)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                values[i, j, k] = min(values[i, j, k] + raised[i, j, k], grid.farthest)


@njit(cache=True, nogil=True, error_model="numpy")
def grid_hits(grid, arm, centres, bounds):  # type: ignore[no-untyped-def]
    """Whether a sphere of a part that moves touches anything; the base stands where it stands."""
    if grid.values.shape[0] == 0:
        return False
    for part in range(bounds.shape[0]):
        if arm.bound_links[part] == 0:
            continue
        reach = arm.bound_radii[part]
        # Where distances are cut off below the reach, a far centre says nothing.
        if reach < grid.farthest and _at(grid, bounds, part) > reach:
            continue
        for at in range(arm.ranges[part, 0], arm.ranges[part, 1]):
            if _at(grid, centres, at) <= arm.radii[at]:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def grid_clearance(grid, arm, centres):  # type: ignore[no-untyped-def]
    """Least distance of a sphere that moves, m, cut off with the grid's; inf where there is no grid."""
    least = np.inf
    if grid.values.shape[0] == 0:
        return least
    for at in range(centres.shape[0]):
        if arm.links[at] > 0:
            least = min(least, _at(grid, centres, at) - arm.radii[at])
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _at(grid, points, index):  # type: ignore[no-untyped-def]
    return grid_distance(points[index, 0], points[index, 1], points[index, 2], grid)
