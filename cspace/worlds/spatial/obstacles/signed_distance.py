"""Signed distance from points and spheres to boxes and cylinders, exact; negative inside."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.worlds.spatial.obstacles.shapes import Obstacles


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
def _is_beyond(x, y, z, row, bound):  # type: ignore[no-untyped-def]
    """Whether the sphere round a shape is at least ``bound`` away, and so is the shape."""
    reach = bound + row[row.shape[0] - 1]
    px, py, pz = x - row[0], y - row[1], z - row[2]
    return reach < 0.0 or px * px + py * py + pz * pz >= reach * reach


@njit(cache=True, nogil=True, error_model="numpy")
def point_distance(x, y, z, boxes, cylinders, bound):  # type: ignore[no-untyped-def]
    """Least signed distance of a point to all obstacles, m, or ``bound`` where none is nearer."""
    for index in range(boxes.shape[0]):
        if not _is_beyond(x, y, z, boxes[index], bound):
            bound = min(bound, box_distance(x, y, z, boxes[index]))
    for index in range(cylinders.shape[0]):
        if not _is_beyond(x, y, z, cylinders[index], bound):
            bound = min(bound, cylinder_distance(x, y, z, cylinders[index]))
    return bound


@njit(cache=True, nogil=True, error_model="numpy")
def points_distance(points, boxes, cylinders):  # type: ignore[no-untyped-def]
    """Of points (N, 3) m, (N,) m; inf without obstacles."""
    out = np.empty(points.shape[0])
    for at in range(points.shape[0]):
        out[at] = point_distance(points[at, 0], points[at, 1], points[at, 2], boxes, cylinders, np.inf)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def set_clearance(centres, radii, boxes, cylinders):  # type: ignore[no-untyped-def]
    """Least signed distance between spheres (S, 3), (S,) and the obstacles, m; inf without either."""
    least = np.inf
    for at in range(centres.shape[0]):
        x, y, z, radius = centres[at, 0], centres[at, 1], centres[at, 2], radii[at]
        least = min(least, point_distance(x, y, z, boxes, cylinders, least + radius) - radius)
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def sets_clearance(centres, radii, boxes, cylinders):  # type: ignore[no-untyped-def]
    """The same of many sets (N, S, 3) with the same radii (S,), (N,) m."""
    out = np.empty(centres.shape[0])
    for at in range(centres.shape[0]):
        out[at] = set_clearance(centres[at], radii, boxes, cylinders)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def set_is_free(centres, radii, boxes, cylinders):  # type: ignore[no-untyped-def]
    """Whether no sphere of (S, 3), (S,) touches an obstacle; stops at the first that does."""
    for at in range(centres.shape[0]):
        x, y, z, radius = centres[at, 0], centres[at, 1], centres[at, 2], radii[at]
        for index in range(boxes.shape[0]):
            row = boxes[index]
            if not _is_beyond(x, y, z, row, radius) and box_distance(x, y, z, row) <= radius:
                return False
        for index in range(cylinders.shape[0]):
            row = cylinders[index]
            if not _is_beyond(x, y, z, row, radius) and cylinder_distance(x, y, z, row) <= radius:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def sets_are_free(centres, radii, boxes, cylinders):  # type: ignore[no-untyped-def]
    """The same of many sets (N, S, 3) with the same radii (S,), (N,) bool."""
    out = np.empty(centres.shape[0], dtype=np.bool_)
    for at in range(centres.shape[0]):
        out[at] = set_is_free(centres[at], radii, boxes, cylinders)
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
    centres = np.ascontiguousarray(centres_m, dtype=np.float64)
    radii = np.ascontiguousarray(radii_m, dtype=np.float64)
    arrays = obstacles.arrays
    found: NDArray[np.float64] = sets_clearance(centres, radii, arrays.boxes, arrays.cylinders)
    return found
