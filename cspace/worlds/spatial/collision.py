"""Collision checks of a serial arm by its spheres: kernels, and the checkers of scenes and of pictures."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.planning.kernels import SceneKernels
from cspace.simulator import Checker
from cspace.worlds.spatial.arm import SerialArm, grouped
from cspace.worlds.spatial.bodies import (
    bodies_clearance,
    bodies_hit,
    box_distance,
    clearance_m,
    cylinder_distance,
    is_beyond,
    point_distance,
    reach_into,
)
from cspace.worlds.spatial.kinematics import (
    ArmArrays,
    arm_arrays,
    limit_arrays,
    link_frames_into,
    points_into,
    self_distance,
    sphere_centres_batch,
)
from cspace.worlds.spatial.obstacles import NO_BODIES, BodyArrays, Obstacles
from cspace.worlds.spatial.poses import moved
from cspace.worlds.spatial.sensor import GridBox
from cspace.worlds.spatial.visibility import distances_m


class DistanceGrid(NamedTuple):
    """Signed distances at the centres of voxels, as the kernels take them."""

    values: NDArray[np.float32]  # (X, Y, Z) m, cut off at `farthest`; nothing without voxels
    low: NDArray[np.float64]  # (3,) lowest corner in the base frame, m
    voxel: float  # side of a voxel, m
    farthest: float  # what stands for all that is farther away, m


# Parts that are farther apart do not touch.
_APART_M = 1e-9
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
    """Raise distances, in place, so that spheres (S, 3), (S,) m just fit where they are known to be free."""
    values, voxel = grid.values, grid.voxel
    raised, first, last = np.zeros_like(values), np.empty(3, np.int64), np.empty(3, np.int64)
    for at in range(centres.shape[0]):
        lacks = radii[at] - grid_distance(centres[at, 0], centres[at, 1], centres[at, 2], grid)
        if lacks < 0.0:
            continue
        most = lacks + slack
        reach_into(first, last, values.shape, grid.low, voxel, centres[at], plateau + most / slope)
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


class SceneArrays(NamedTuple):
    """An arm of d joints among obstacles as the kernels take it."""

    arm: ArmArrays
    boxes: NDArray[np.float64]  # (B, 16), see :class:`cspace.worlds.spatial.obstacles.BodyArrays`
    cylinders: NDArray[np.float64]  # (C, 15), likewise
    grid: DistanceGrid
    bodies: BodyArrays
    lower: NDArray[np.float64]  # (d,) rad
    upper: NDArray[np.float64]  # (d,) rad
    periodic: NDArray[np.bool_]  # (d,) which joints are circles
    # (U, 7) axes of the last link that stay near directions of the base: either unit vector, and the least
    # cosine of the angle between the two
    upright: NDArray[np.float64] = np.empty((0, 7))


def scene_arrays(
    arm: SerialArm, obstacles: Obstacles, grid: DistanceGrid = NOTHING, bodies: BodyArrays = NO_BODIES
) -> SceneArrays:
    """The arrays of an arm among obstacles, and what stands on a grid and is known beside them."""
    stood, limits = obstacles.arrays, limit_arrays(arm.space)
    return SceneArrays(arm_arrays(arm), stood.boxes, stood.cylinders, grid, bodies, *limits)


@njit(cache=True, nogil=True, error_model="numpy")
def room_of(scene):  # type: ignore[no-untyped-def]
    """Arrays to work in: links' frames, spheres' centres, centres of the spheres round the parts."""
    arm = scene.arm
    return (
        np.empty((arm.axes.shape[0] + 1, 4, 4)),
        np.empty(arm.centres.shape),
        np.empty(arm.bound_centres.shape),
    )


def _hit_test(distance: Any) -> Any:
    @njit(cache=True, nogil=True, error_model="numpy")
    def hits(row, arm, centres, bounds):  # type: ignore[no-untyped-def]
        """Whether a sphere of a part that moves touches a shape, whose distance to points a kernel knows."""
        for part in range(bounds.shape[0]):
            if arm.bound_links[part] == 0:
                continue
            reach, x, y, z = arm.bound_radii[part], bounds[part, 0], bounds[part, 1], bounds[part, 2]
            if is_beyond(x, y, z, row, reach) or distance(x, y, z, row) > reach:
                continue
            for at in range(arm.ranges[part, 0], arm.ranges[part, 1]):
                if distance(centres[at, 0], centres[at, 1], centres[at, 2], row) <= arm.radii[at]:
                    return True
        return False

    return hits


_box_hits, _cylinder_hits = _hit_test(box_distance), _hit_test(cylinder_distance)


@njit(cache=True, nogil=True, error_model="numpy")
def state_is_free(q, scene, room):  # type: ignore[no-untyped-def]
    """Whether one configuration (d,) is within its limits, clear of every obstacle and of itself."""
    for joint in range(q.shape[0]):
        if not scene.periodic[joint] and not scene.lower[joint] <= q[joint] <= scene.upper[joint]:
            return False
    frames, centres, bounds = room
    arm = scene.arm
    link_frames_into(q, arm.origins, arm.axes, frames)
    for index in range(scene.upright.shape[0]):
        if not _is_upright(scene.upright[index], frames[q.shape[0]]):
            return False
    points_into(frames, arm.bound_links, arm.bound_centres, bounds)
    points_into(frames, arm.links, arm.centres, centres)
    for index in range(scene.boxes.shape[0]):
        if _box_hits(scene.boxes[index], arm, centres, bounds):
            return False
    for index in range(scene.cylinders.shape[0]):
        if _cylinder_hits(scene.cylinders[index], arm, centres, bounds):
            return False
    if grid_hits(scene.grid, arm, centres, bounds) or bodies_hit(scene.bodies, arm, centres, bounds):
        return False
    return self_distance(centres, bounds, arm, _APART_M) > 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def state_clearance(q, scene, room):  # type: ignore[no-untyped-def]
    """Least signed distance of what moves to an obstacle, or between parts that can touch, m; inf without."""
    frames, centres, bounds = room
    arm = scene.arm
    link_frames_into(q, arm.origins, arm.axes, frames)
    points_into(frames, arm.bound_links, arm.bound_centres, bounds)
    points_into(frames, arm.links, arm.centres, centres)
    least = self_distance(centres, bounds, arm, grid_clearance(scene.grid, arm, centres))
    least = min(least, bodies_clearance(scene.bodies, arm, centres))
    for at in range(centres.shape[0]):
        if arm.links[at] > 0:
            x, y, z, radius = centres[at, 0], centres[at, 1], centres[at, 2], arm.radii[at]
            away = point_distance(x, y, z, scene.boxes, scene.cylinders, least + radius)
            least = min(least, away - radius)
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _is_upright(row, frame):  # type: ignore[no-untyped-def]
    cosine = 0.0
    for at in range(3):
        cosine += row[3 + at] * (frame[at, 0] * row[0] + frame[at, 1] * row[1] + frame[at, 2] * row[2])
    return cosine >= row[6]


KERNELS = SceneKernels(state_is_free, state_clearance, room_of)


class CollisionChecker(Checker):
    """Collision checks of a serial arm in one scene, by the spheres that cover it."""

    def __init__(
        self,
        arm: SerialArm,
        obstacles: Obstacles,
        grid: DistanceGrid = NOTHING,
        bodies: BodyArrays = NO_BODIES,
    ) -> None:
        super().__init__(arm.space, scene_arrays(arm, obstacles, grid, bodies), KERNELS)
        self.arm, self.obstacles = arm, obstacles


def group_hits(
    arm: SerialArm, obstacles: Obstacles, configurations: ArrayLike, groups: int
) -> NDArray[np.bool_]:
    """Which groups of spheres touch an obstacle at (N, d) rad, (N, G); without those that stand still."""
    found, radii = grouped(arm, groups), arm.spheres_m()[:, 3]
    rows = np.ascontiguousarray(configurations, dtype=np.float64)
    centres = sphere_centres_batch(rows, arm_arrays(arm))
    moving = np.flatnonzero(found.links > 0)
    round_groups = moved(arm.link_frames(rows)[:, found.links], found.spheres_m[:, :3])
    hits = np.zeros((len(rows), len(moving)), dtype=np.bool_)
    for column, number in enumerate(moving):
        # Few of the spheres that hold a group are near anything.
        near = clearance_m(obstacles, round_groups[:, number, None], found.spheres_m[number, 3:]) <= 0.0
        members = np.flatnonzero(found.groups == number)
        hits[near, column] = clearance_m(obstacles, centres[near][:, members], radii[members]) <= 0.0
    return hits


# That is kept to what is seen; the most careful first.
MARGINS_M = (0.015, 0.005, 0.0)
# Room at the ends of a path: beyond what the arm lacks, m; up to where, m; and how fast it ends.
_SLACK_M, _PLATEAU_M, _SLOPE = 0.01, 0.03, 0.5
_NO_OBSTACLES = Obstacles((), ())


def seen_checkers(
    world: Any,
    picture: NDArray[np.uint8],
    ends: NDArray[np.float64],
    obstacles: Obstacles = _NO_OBSTACLES,
    *,
    known: Any = None,
) -> list[CollisionChecker]:
    """See :func:`cspace.worlds.seen_checkers`; ``known``: a scene checker; obstacles stand there, too."""
    arm, bodies = (world.body, NO_BODIES) if known is None else (known.arm, known.bodies)
    grid = world.sensor.grid
    if known is not None and known.seen is not None:
        picture = known.seen
    worlds = [distances_m(picture) - np.float32(margin_m) for margin_m in MARGINS_M]
    return world_checkers(arm, worlds, grid, ends, obstacles, bodies)


def world_checkers(
    arm: SerialArm,
    worlds: Iterable[NDArray[np.float32]],
    grid: GridBox,
    ends: NDArray[np.float64],
    obstacles: Obstacles = _NO_OBSTACLES,
    bodies: BodyArrays = NO_BODIES,
) -> list[CollisionChecker]:
    """A checker for each world's distances (X, Y, Z) m, by which the arm is free at ``ends`` (k, d) rad."""
    arrays = arm_arrays(arm)
    moving = arrays.links > 0
    centres = sphere_centres_batch(np.ascontiguousarray(ends, dtype=np.float64), arrays)[:, moving]
    radii = np.tile(arrays.radii[moving], len(centres))
    found = []
    for world in worlds:
        away = distance_grid(world.copy(), grid.low_m, grid.voxel_m)
        make_room(away, centres.reshape(-1, 3), radii, _SLACK_M, _PLATEAU_M, _SLOPE)
        found.append(CollisionChecker(arm, obstacles, away, bodies))
    return found
