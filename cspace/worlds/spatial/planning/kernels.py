"""Collision checks of a serial arm among obstacles, by spheres: kernels for one state, a way and batches.

A state is free within its limits, clear of every obstacle and of itself. A part's spheres are looked at only
where the sphere round the part touches something.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.obstacles.signed_distance import (
    box_distance,
    cylinder_distance,
    set_clearance,
)
from cspace.worlds.spatial.planning.distance_grid import NOTHING, DistanceGrid, grid_clearance, grid_hits
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.kinematics import (
    ArmArrays,
    arm_arrays,
    link_frames_into,
    points_into,
    self_distance,
)

TWO_PI = 2.0 * np.pi


class SceneArrays(NamedTuple):
    """An arm of d joints among obstacles as the kernels take it.

    Attributes:
        arm: its arrays.
        boxes: (B, 16), see :class:`cspace.worlds.spatial.obstacles.shapes.ObstacleArrays`.
        cylinders: (C, 15), likewise.
        grid: distances to what pictures show.
        lower: (d,) rad.
        upper: (d,) rad.
        periodic: (d,) which joints are circles.
    """

    arm: ArmArrays
    boxes: NDArray[np.float64]
    cylinders: NDArray[np.float64]
    grid: DistanceGrid
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    periodic: NDArray[np.bool_]


def scene_arrays(arm: SerialArm, obstacles: Obstacles, grid: DistanceGrid = NOTHING) -> SceneArrays:
    """The arrays of an arm among obstacles, and what stands on a grid beside them."""
    space, stood = arm.space, obstacles.arrays
    return SceneArrays(
        arm_arrays(arm),
        stood.boxes,
        stood.cylinders,
        grid,
        np.asarray(space.lower, dtype=np.float64),
        np.asarray(space.upper, dtype=np.float64),
        np.asarray(space.periodic, dtype=np.bool_),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def room_of(scene):  # type: ignore[no-untyped-def]
    """Arrays to work in: links' frames, spheres' centres, centres of the spheres round the parts."""
    arm = scene.arm
    return (
        np.empty((arm.axes.shape[0] + 1, 4, 4)),
        np.empty(arm.centres.shape),
        np.empty(arm.bound_centres.shape),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def state_is_free(q, scene, room):  # type: ignore[no-untyped-def]
    """Whether one configuration (d,) is within its limits, clear of every obstacle and of itself."""
    for joint in range(q.shape[0]):
        if not scene.periodic[joint] and not scene.lower[joint] <= q[joint] <= scene.upper[joint]:
            return False
    frames, centres, bounds = room
    arm = scene.arm
    link_frames_into(q, arm.origins, arm.axes, frames)
    points_into(frames, arm.bound_links, arm.bound_centres, bounds)
    points_into(frames, arm.links, arm.centres, centres)
    for index in range(scene.boxes.shape[0]):
        if _box_hits(scene.boxes[index], arm, centres, bounds):
            return False
    for index in range(scene.cylinders.shape[0]):
        if _cylinder_hits(scene.cylinders[index], arm, centres, bounds):
            return False
    if grid_hits(scene.grid, arm, centres, bounds):
        return False
    return not _hits_itself(arm, centres, bounds)


@njit(cache=True, nogil=True, error_model="numpy")
def state_clearance(q, scene, room):  # type: ignore[no-untyped-def]
    """Least signed distance to an obstacle or between parts that can touch, m; inf without either."""
    frames, centres, bounds = room
    arm = scene.arm
    link_frames_into(q, arm.origins, arm.axes, frames)
    points_into(frames, arm.bound_links, arm.bound_centres, bounds)
    points_into(frames, arm.links, arm.centres, centres)
    least = min(grid_clearance(scene.grid, arm, centres), self_distance(centres, bounds, arm))
    return min(set_clearance(centres, arm.radii, scene.boxes, scene.cylinders), least)


@njit(cache=True, nogil=True, error_model="numpy")
def _box_hits(row, arm, centres, bounds):  # type: ignore[no-untyped-def]
    for part in range(bounds.shape[0]):
        reach, x, y, z = arm.bound_radii[part], bounds[part, 0], bounds[part, 1], bounds[part, 2]
        if _beyond(x, y, z, row, reach) or box_distance(x, y, z, row) > reach:
            continue
        for at in range(arm.ranges[part, 0], arm.ranges[part, 1]):
            if box_distance(centres[at, 0], centres[at, 1], centres[at, 2], row) <= arm.radii[at]:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _cylinder_hits(row, arm, centres, bounds):  # type: ignore[no-untyped-def]
    for part in range(bounds.shape[0]):
        reach, x, y, z = arm.bound_radii[part], bounds[part, 0], bounds[part, 1], bounds[part, 2]
        if _beyond(x, y, z, row, reach) or cylinder_distance(x, y, z, row) > reach:
            continue
        for at in range(arm.ranges[part, 0], arm.ranges[part, 1]):
            if cylinder_distance(centres[at, 0], centres[at, 1], centres[at, 2], row) <= arm.radii[at]:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond(x, y, z, row, reach):  # type: ignore[no-untyped-def]
    """Whether the sphere round a shape is farther away than ``reach``."""
    far = reach + row[row.shape[0] - 1]
    px, py, pz = x - row[0], y - row[1], z - row[2]
    return px * px + py * py + pz * pz > far * far


@njit(cache=True, nogil=True, error_model="numpy")
def _hits_itself(arm, centres, bounds):  # type: ignore[no-untyped-def]
    for pair in range(arm.pairs.shape[0]):
        i, j = arm.pairs[pair, 0], arm.pairs[pair, 1]
        if not _touch(bounds, arm.bound_radii, i, bounds, arm.bound_radii, j):
            continue
        for first in range(arm.ranges[i, 0], arm.ranges[i, 1]):
            if not _touch(centres, arm.radii, first, bounds, arm.bound_radii, j):
                continue
            for second in range(arm.ranges[j, 0], arm.ranges[j, 1]):
                if _touch(centres, arm.radii, first, centres, arm.radii, second):
                    return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _touch(first, first_radii, i, second, second_radii, j):  # type: ignore[no-untyped-def]
    x, y, z = first[i, 0] - second[j, 0], first[i, 1] - second[j, 1], first[i, 2] - second[j, 2]
    reach = first_radii[i] + second_radii[j]
    return x * x + y * y + z * z <= reach * reach


@njit(cache=True, nogil=True, error_model="numpy")
def checked_edge(a, b, resolution, scene, room):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped way from ``a`` to ``b`` is free, and how many states were looked at.

    Both ends are included. Neighbouring states are at most ``resolution`` rad apart in every joint. They are
    looked at in the order of a bisection, which finds collisions sooner and changes no result.
    """
    dim = a.shape[0]
    step, q = np.empty(dim), np.empty(dim)
    longest = 0.0
    for joint in range(dim):
        step[joint] = gap(a[joint], b[joint], scene.periodic[joint])
        longest = max(longest, abs(step[joint]))
    count = max(1, int(np.ceil(longest / resolution)))
    stride = 1
    while stride < count:
        stride *= 2
    begin, jump, looked = 0, stride, 0
    while stride >= 1:
        for index in range(begin, count + 1, jump):
            for joint in range(dim):
                q[joint] = a[joint] + step[joint] * index / count
            looked += 1
            if not state_is_free(q, scene, room):
                return False, looked
        begin, jump = stride // 2, stride
        stride //= 2
    for joint in range(dim):
        q[joint] = a[joint] + step[joint]
    return state_is_free(q, scene, room), looked + 1


@njit(cache=True, nogil=True, error_model="numpy")
def gap(begin, end, wraps):  # type: ignore[no-untyped-def]
    """The way from one angle to another, the shorter one on a circle."""
    found = end - begin
    return (found + np.pi) % TWO_PI - np.pi if wraps else found


@njit(cache=True, nogil=True, error_model="numpy")
def free_batch(q, scene):  # type: ignore[no-untyped-def]
    """Which of (N, d) are free, (N,)."""
    out, room = np.empty(q.shape[0], dtype=np.bool_), room_of(scene)
    for row in range(q.shape[0]):
        out[row] = state_is_free(q[row], scene, room)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def clearance_batch(q, scene):  # type: ignore[no-untyped-def]
    """Clearance of each of (N, d), (N,) m."""
    out, room = np.empty(q.shape[0]), room_of(scene)
    for row in range(q.shape[0]):
        out[row] = state_clearance(q[row], scene, room)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def edge_batch(a, b, resolution, scene):  # type: ignore[no-untyped-def]
    """Which ways between (N, d) and (N, d) are free, (N,)."""
    out, room = np.empty(a.shape[0], dtype=np.bool_), room_of(scene)
    for row in range(a.shape[0]):
        out[row] = checked_edge(a[row], b[row], resolution, scene, room)[0]
    return out
