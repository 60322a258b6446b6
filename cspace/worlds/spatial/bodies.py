"""Signed distances, compiled, to obstacles and to known bodies: boxes, cylinders, spheres and meshes.

A mesh is looked up in a tree of bounding boxes; a closed one is solid, an open one is its surface alone.
Source of the point's distance to a triangle: Ericson, Real-Time Collision Detection (2005), section 5.1.5.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.sensor import BEHIND_STEP_M, DISTANCE_STEP_M, FARTHEST, FREE, MOST_BEHIND

# What counts as farther than a bound is so much farther at least.
_MORE_M = 1e-6
_STACK = 96
# Of a ray that meets no edge of usual meshes.
_RAY = (0.5298129428260175, 0.6324555320336759, 0.5651003626478917)


@njit(cache=True, nogil=True, error_model="numpy")
def _outside_and_in(one, two, three):  # type: ignore[no-untyped-def]
    """From how far a point is beyond each pair of faces, negative between them."""
    inside = min(max(one, two, three), 0.0)
    one, two, three = max(one, 0.0), max(two, 0.0), max(three, 0.0)
    return inside + np.sqrt(one * one + two * two + three * three)


@njit(cache=True, nogil=True, error_model="numpy")
def box_distance(x, y, z, row):  # type: ignore[no-untyped-def]
    """Of a point to a row of :class:`BodyArrays` ``boxes``, m."""
    px, py, pz = x - row[0], y - row[1], z - row[2]
    along_x = abs(row[3] * px + row[6] * py + row[9] * pz) - row[12]
    along_y = abs(row[4] * px + row[7] * py + row[10] * pz) - row[13]
    along_z = abs(row[5] * px + row[8] * py + row[11] * pz) - row[14]
    return _outside_and_in(along_x, along_y, along_z)


@njit(cache=True, nogil=True, error_model="numpy")
def cylinder_distance(x, y, z, row):  # type: ignore[no-untyped-def]
    """Of a point to a row of :class:`BodyArrays` ``cylinders``, m."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def body_distance(x, y, z, number, bodies, bound):  # type: ignore[no-untyped-def]
    """Signed distance of a point to a body, m; something above ``bound`` where it is farther than that."""
    px, py, pz = x - bodies.centres[number, 0], y - bodies.centres[number, 1], z - bodies.centres[number, 2]
    far = bound + bodies.reaches[number]
    if far < 0.0 or px * px + py * py + pz * pz > far * far:
        return bound + _MORE_M
    if number < bodies.boxes.shape[0]:
        return box_distance(x, y, z, bodies.boxes[number])
    number -= bodies.boxes.shape[0]
    if number < bodies.cylinders.shape[0]:
        return cylinder_distance(x, y, z, bodies.cylinders[number])
    number -= bodies.cylinders.shape[0]
    if number < bodies.spheres.shape[0]:
        return np.sqrt(px * px + py * py + pz * pz) - bodies.spheres[number, 3]
    return _mesh_distance(x, y, z, number - bodies.spheres.shape[0], bodies, bound)


@njit(cache=True, nogil=True, error_model="numpy")
def _mesh_distance(x, y, z, mesh, bodies, bound):  # type: ignore[no-untyped-def]
    root = bodies.roots[mesh]
    inside = bodies.closed[mesh] and _gap_to_box(x, y, z, bodies, root) == 0.0
    if inside and _crossings(x, y, z, bodies, root) % 2 == 1:
        return -np.sqrt(_least_square(x, y, z, bodies, root, np.inf))
    if bound < 0.0:
        return bound + _MORE_M
    least = (bound + _MORE_M) ** 2
    return np.sqrt(_least_square(x, y, z, bodies, root, least))


@njit(cache=True, nogil=True, error_model="numpy")
def _gap_to_box(x, y, z, bodies, node):  # type: ignore[no-untyped-def]
    """Square of the distance of a point to a node's box."""
    low, high = bodies.lows[node], bodies.highs[node]
    dx = max(low[0] - x, 0.0, x - high[0])
    dy = max(low[1] - y, 0.0, y - high[1])
    dz = max(low[2] - z, 0.0, z - high[2])
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True, error_model="numpy")
def _least_square(x, y, z, bodies, root, least):  # type: ignore[no-untyped-def]
    """Square of the distance to the nearest triangle, ``least`` where none is nearer."""
    stack = np.empty(_STACK, np.int64)
    stack[0], held = root, 1
    while held:
        held -= 1
        node = stack[held]
        if _gap_to_box(x, y, z, bodies, node) >= least:
            continue
        if bodies.rights[node] < 0:
            for at in range(bodies.firsts[node], bodies.firsts[node] + bodies.counts[node]):
                least = min(least, _triangle_square(x, y, z, bodies.corners[at]))
            continue
        near, other = node + 1, bodies.rights[node]
        if _gap_to_box(x, y, z, bodies, near) > _gap_to_box(x, y, z, bodies, other):
            near, other = other, near
        stack[held], stack[held + 1] = other, near
        held += 2
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle_square(x, y, z, corners):  # type: ignore[no-untyped-def]
    """Square of the distance of a point to a triangle (3, 3)."""
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    px, py, pz = x - a[0], y - a[1], z - a[2]
    uu, uv, vv = _dot(ux, uy, uz, ux, uy, uz), _dot(ux, uy, uz, vx, vy, vz), _dot(vx, vy, vz, vx, vy, vz)
    up, vp = _dot(ux, uy, uz, px, py, pz), _dot(vx, vy, vz, px, py, pz)
    # Scalar products of the edges from a with the ways from b and c to the point.
    up_b, vp_b, up_c, vp_c = up - uu, vp - uv, up - uv, vp - vv
    at_c, at_b, at_a = up * vp_b - up_b * vp, up_c * vp - up * vp_c, up_b * vp_c - up_c * vp_b
    if up <= 0.0 and vp <= 0.0:
        s, t = 0.0, 0.0
    elif up_b >= 0.0 and vp_b <= up_b:
        s, t = 1.0, 0.0
    elif vp_c >= 0.0 and up_c <= vp_c:
        s, t = 0.0, 1.0
    elif at_c <= 0.0 and up >= 0.0 and up_b <= 0.0:
        s, t = up / uu, 0.0
    elif at_b <= 0.0 and vp >= 0.0 and vp_c <= 0.0:
        s, t = 0.0, vp / vv
    elif at_a <= 0.0 and vp_b >= up_b and up_c >= vp_c:
        t = (vp_b - up_b) / ((vp_b - up_b) + (up_c - vp_c))
        s = 1.0 - t
    else:
        whole = at_a + at_b + at_c
        s, t = at_b / whole, at_c / whole
    dx, dy, dz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True, error_model="numpy")
def _dot(a, b, c, x, y, z):  # type: ignore[no-untyped-def]
    return a * x + b * y + c * z


@njit(cache=True, nogil=True, error_model="numpy")
def _crossings(x, y, z, bodies, root):  # type: ignore[no-untyped-def]
    """How many triangles of a mesh a ray from a point meets (Moeller and Trumbore 1997)."""
    stack = np.empty(_STACK, np.int64)
    stack[0], held, found = root, 1, 0
    point = (x, y, z)
    while held:
        held -= 1
        node = stack[held]
        enters, leaves = 0.0, np.inf
        for axis in range(3):
            one = (bodies.lows[node, axis] - point[axis]) / _RAY[axis]
            other = (bodies.highs[node, axis] - point[axis]) / _RAY[axis]
            enters, leaves = max(enters, one), min(leaves, other)
        if enters > leaves:
            continue
        if bodies.rights[node] >= 0:
            stack[held], stack[held + 1] = bodies.rights[node], node + 1
            held += 2
            continue
        for at in range(bodies.firsts[node], bodies.firsts[node] + bodies.counts[node]):
            found += _is_met(x, y, z, bodies.corners[at])
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _is_met(x, y, z, corners):  # type: ignore[no-untyped-def]
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    hx, hy, hz = _RAY[1] * vz - _RAY[2] * vy, _RAY[2] * vx - _RAY[0] * vz, _RAY[0] * vy - _RAY[1] * vx
    whole = _dot(ux, uy, uz, hx, hy, hz)
    if whole == 0.0:
        return False
    sx, sy, sz = x - a[0], y - a[1], z - a[2]
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    s = _dot(sx, sy, sz, hx, hy, hz) / whole
    t = _dot(qx, qy, qz, _RAY[0], _RAY[1], _RAY[2]) / whole
    return 0.0 <= s <= 1.0 and t >= 0.0 and s + t <= 1.0 and _dot(vx, vy, vz, qx, qy, qz) / whole > 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def bodies_hit(bodies, arm, centres, bounds):  # type: ignore[no-untyped-def]
    """Whether a sphere of the arm touches a body that its part may not touch."""
    for number in range(bodies.centres.shape[0]):
        # Most pairs are told apart by the spheres round them.
        u, v, w = bodies.centres[number, 0], bodies.centres[number, 1], bodies.centres[number, 2]
        round_body = bodies.reaches[number]
        for part in range(bounds.shape[0]):
            x, y, z = bounds[part, 0], bounds[part, 1], bounds[part, 2]
            reach = arm.bound_radii[part]
            if (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2 > (reach + round_body) ** 2:
                continue
            if bodies.exempt[part, number] or body_distance(x, y, z, number, bodies, reach) > reach:
                continue
            for index in range(arm.ranges[part, 0], arm.ranges[part, 1]):
                x, y, z, radius = centres[index, 0], centres[index, 1], centres[index, 2], arm.radii[index]
                if (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2 > (radius + round_body) ** 2:
                    continue
                if body_distance(x, y, z, number, bodies, radius) <= radius:
                    return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def bodies_clearance(bodies, arm, centres):  # type: ignore[no-untyped-def]
    """Least signed distance of a sphere to a body that its part may not touch, m; inf without such."""
    least = np.inf
    for number in range(bodies.centres.shape[0]):
        for part in range(arm.ranges.shape[0]):
            if not bodies.exempt[part, number]:
                least = min(least, part_contact(bodies, arm, centres, number, part, least)[0])
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def part_contact(bodies, arm, centres, number, part, least):  # type: ignore[no-untyped-def]
    """Signed distance of a part to a body, m, ``least`` where it is not nearer, and the sphere's number."""
    found = -1
    for index in range(arm.ranges[part, 0], arm.ranges[part, 1]):
        radius, at = arm.radii[index], centres[index]
        away = body_distance(at[0], at[1], at[2], number, bodies, least + radius) - radius
        if away < least:
            least, found = away, index
    return least, found


@njit(cache=True, nogil=True, error_model="numpy")
def points_to_bodies(points, bodies, bound):  # type: ignore[no-untyped-def]
    """Signed distance of points (N, 3) m to the nearest body, (N,) m, cut off a little above ``bound``."""
    out = np.empty(points.shape[0])
    for at in range(points.shape[0]):
        least = bound + _MORE_M
        for number in range(bodies.centres.shape[0]):
            x, y, z = points[at, 0], points[at, 1], points[at, 2]
            least = min(least, body_distance(x, y, z, number, bodies, max(least, 0.0)))
        out[at] = least
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def are_inside(centres, radii, bodies):  # type: ignore[no-untyped-def]
    """Which rows of spheres (N, S, 3) m of radii (S,) m lie in bodies, each sphere in one of them, (N,)."""
    out = np.ones(centres.shape[0], np.bool_)
    for row in range(centres.shape[0]):
        for index in range(centres.shape[1]):
            x, y, z = centres[row, index, 0], centres[row, index, 1], centres[row, index, 2]
            inside = False
            for number in range(bodies.centres.shape[0]):
                inside = inside or body_distance(x, y, z, number, bodies, -radii[index]) <= -radii[index]
            if not inside:
                out[row] = False
                break
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def reach_into(first, last, counts, low, voxel, centre, radius):  # type: ignore[no-untyped-def]
    """Fill in the numbers of the first and last voxels whose centres may lie within a radius."""
    for axis in range(3):
        at = (centre[axis] - low[axis]) / voxel - 0.5
        first[axis] = max(0, int(np.ceil(at - radius / voxel)))
        last[axis] = min(counts[axis] - 1, int(np.floor(at + radius / voxel)))


@njit(cache=True, nogil=True, error_model="numpy")
def write_body(observed, low, voxel, number, bodies, is_free, begin, end):  # type: ignore[no-untyped-def]
    """Write a body into layers of an array (X, Y, Z, 2): its inside as seen free, or its surface as seen."""
    farthest = 0.0 if is_free else FARTHEST * DISTANCE_STEP_M
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    reach = bodies.reaches[number] + farthest
    reach_into(first, last, observed.shape, low, voxel, bodies.centres[number], reach)
    for i in range(max(first[0], begin), min(last[0] + 1, end)):
        x = low[0] + (i + 0.5) * voxel
        for j in range(first[1], last[1] + 1):
            y = low[1] + (j + 0.5) * voxel
            for k in range(first[2], last[2] + 1):
                away = body_distance(x, y, low[2] + (k + 0.5) * voxel, number, bodies, farthest)
                if is_free:
                    if away <= 0.0:
                        observed[i, j, k, 1] = np.uint8(FREE)
                    continue
                code = np.uint8(min(np.rint(abs(away) / DISTANCE_STEP_M), FARTHEST))
                observed[i, j, k, 0] = min(observed[i, j, k, 0], code)
                if away < 0.0:
                    behind = 1 + min(int(-away / BEHIND_STEP_M), MOST_BEHIND - 1)
                    observed[i, j, k, 1] = np.uint8(behind)
