"""Collision checks of a serial arm by its spheres: kernels, and the checkers of scenes and of pictures."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from cspace.planning.kernels import TWO_PI, gap
from cspace.simulator import EdgeTest, StateTest
from cspace.space import JointSpace
from cspace.worlds.spatial.arm import SerialArm, grouped
from cspace.worlds.spatial.distances import (
    NOTHING,
    DistanceGrid,
    box_distance,
    clear_spheres,
    cylinder_distance,
    distance_grid,
    grid_clearance,
    grid_hits,
    set_clearance,
    sets_are_free,
)
from cspace.worlds.spatial.kinematics import (
    ArmArrays,
    arm_arrays,
    link_frames_into,
    points_into,
    self_distance,
    sphere_centres_batch,
)
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.poses import moved
from cspace.worlds.spatial.visibility import distances_m
from cspace.worlds.spatial.world import SpatialWorld


class SceneArrays(NamedTuple):
    """An arm of d joints among obstacles as the kernels take it.

    Attributes:
        arm: its arrays.
        boxes: (B, 16), see :class:`cspace.worlds.spatial.obstacles.ObstacleArrays`.
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


_TRAPPED, _ADVANCED, _REACHED = 0, 1, 2


@njit(cache=True, nogil=True)
def advance(nodes, parents, counts, checks, states, side, reach, resolution, scene):  # type: ignore[no-untyped-def]
    """Grow by a block of states: iterations, whose turn it is, the shared node or -1 twice.

    ``checks`` counts on: edges, and states within them and alone.
    """
    room = room_of(scene)
    for index in range(states.shape[0]):
        other = 1 - side
        status = _grow(nodes, parents, counts, checks, side, states[index], reach, resolution, scene, room)
        if status != _TRAPPED:
            target = nodes[side, counts[side] - 1].copy()
            status = _ADVANCED
            while status == _ADVANCED:
                status = _grow(nodes, parents, counts, checks, other, target, reach, resolution, scene, room)
            if status == _REACHED:
                return index + 1, other, counts[0] - 1, counts[1] - 1
        side = other
    return states.shape[0], side, -1, -1


@njit(cache=True, nogil=True)
def _grow(nodes, parents, counts, checks, side, target, reach, resolution, scene, room):  # type: ignore[no-untyped-def]
    """One step of a tree towards a configuration: trapped, advanced or reached."""
    dim = target.shape[0]
    if counts[side] == nodes.shape[1]:
        return _TRAPPED
    nearest, least = _nearest(nodes[side], counts[side], target, scene.periodic)
    share = min(1.0, reach / least) if least > 0.0 else 1.0
    new = np.empty(dim)
    for joint in range(dim):
        begin = nodes[side, nearest, joint]
        new[joint] = begin + share * gap(begin, target[joint], scene.periodic[joint])
        if scene.periodic[joint]:
            new[joint] = (new[joint] + np.pi) % TWO_PI - np.pi
    if share == 1.0:
        new[:] = target
    # The goal's tree looks at the new state before its edge, as OMPL's does.
    if side == 1:
        checks[1] += 1
        if not state_is_free(new, scene, room):
            return _TRAPPED
    free, states = checked_edge(nodes[side, nearest], new, resolution, scene, room)
    checks[0] += 1
    checks[1] += states
    if not free:
        return _TRAPPED
    nodes[side, counts[side]] = new
    parents[side, counts[side]] = nearest
    counts[side] += 1
    return _REACHED if share == 1.0 else _ADVANCED


@njit(cache=True, nogil=True)
def _nearest(nodes, count, target, periodic):  # type: ignore[no-untyped-def]
    """The node that is nearest by the sum over the joints, and how far it is."""
    nearest, least = 0, np.inf
    for node in range(count):
        distance = 0.0
        for joint in range(target.shape[0]):
            distance += abs(gap(nodes[node, joint], target[joint], periodic[joint]))
        if distance < least:
            nearest, least = node, distance
    return nearest, least


class CollisionChecker:
    """The port :class:`cspace.simulator.Checker` for a serial arm.

    Args:
        arm: with its spheres.
        obstacles: in the base frame.
        grid: distances to what else is there, as pictures show it.
    """

    def __init__(self, arm: SerialArm, obstacles: Obstacles, grid: DistanceGrid = NOTHING) -> None:
        self.arm, self.obstacles = arm, obstacles
        self.scene = scene_arrays(arm, obstacles, grid)

    @property
    def space(self) -> JointSpace:
        """The arm's joint space."""
        return self.arm.space

    def valid(self, configuration: ArrayLike) -> bool:
        """Whether one configuration (d,) rad is free."""
        return bool(self.valid_batch(np.atleast_2d(np.asarray(configuration, dtype=np.float64)))[0])

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""
        found: NDArray[np.bool_] = free_batch(self._rows(configurations), self.scene)
        return found

    def clearance(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Distance to obstacles or of the arm to itself, of (N, d) rad, (N,) m; negative in collision."""
        found: NDArray[np.float64] = clearance_batch(self._rows(configurations), self.scene)
        return found

    def edge(self, start: ArrayLike, end: ArrayLike, resolution_rad: float) -> bool:
        """Whether the straight way between two configurations (d,) rad is free."""
        first, second = (np.atleast_2d(np.asarray(q, dtype=np.float64)) for q in (start, end))
        return bool(self.edge_batch(first, second, resolution_rad)[0])

    def edge_batch(self, starts: ArrayLike, ends: ArrayLike, resolution_rad: float) -> NDArray[np.bool_]:
        """Which of the ways between (N, d) and (N, d) rad are free, (N,).

        Raises:
            ScenarioError: the shapes differ or the resolution is not positive.
        """
        first, second = self._rows(starts), self._rows(ends)
        if first.shape != second.shape or not resolution_rad > 0.0:
            raise ScenarioError(
                "the edges do not fit",
                expected="as many starts as ends and a positive resolution",
                got=f"{first.shape}, {second.shape}, {resolution_rad} rad",
            )
        found: NDArray[np.bool_] = edge_batch(first, second, float(resolution_rad), self.scene)
        return found

    def state_test(self) -> StateTest:
        """See :meth:`cspace.simulator.Checker.state_test`."""
        scene, room = self.scene, room_of(self.scene)

        def is_free(configuration: NDArray[np.float64]) -> bool:
            return bool(state_is_free(configuration, scene, room))

        # A process's first call loads the compiled kernel, which is no part of a search.
        is_free(np.zeros(self.arm.dim))
        return is_free

    def edge_test(self, resolution_rad: float) -> EdgeTest:
        """See :meth:`cspace.simulator.Checker.edge_test`."""
        scene, room = self.scene, room_of(self.scene)

        def check(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[bool, int]:
            found: tuple[bool, int] = checked_edge(start, end, resolution_rad, scene, room)
            return found

        check(np.zeros(self.arm.dim), np.zeros(self.arm.dim))
        return check

    def grow_trees(
        self,
        nodes: NDArray[np.float64],
        parents: NDArray[np.int64],
        counts: NDArray[np.int64],
        checks: NDArray[np.int64],
        states: NDArray[np.float64],
        side: int,
        range_rad: float,
        resolution_rad: float,
    ) -> tuple[int, int, int, int]:
        """See :func:`cspace.worlds.spatial.checks.advance`."""
        grown: tuple[int, int, int, int] = advance(
            nodes, parents, counts, checks, states, side, range_rad, resolution_rad, self.scene
        )
        return grown

    def _rows(self, configurations: ArrayLike) -> NDArray[np.float64]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.arm.dim:
            raise ScenarioError(
                "the configurations do not fit the robot",
                expected=f"shape (N, {self.arm.dim})",
                got=str(rows.shape),
            )
        return rows


def group_hits(
    arm: SerialArm, obstacles: Obstacles, configurations: ArrayLike, groups: int
) -> NDArray[np.bool_]:
    """Which groups of spheres touch an obstacle at (N, d) rad, (N, G); those that do not move are left out.

    Args:
        arm: with its spheres.
        obstacles: in the base frame.
        configurations: of the arm.
        groups: as :func:`cspace.worlds.spatial.arm.grouped` has it.
    """
    found, radii, stood = grouped(arm, groups), arm.spheres_m()[:, 3], obstacles.arrays
    rows = np.ascontiguousarray(configurations, dtype=np.float64)
    centres = sphere_centres_batch(rows, arm_arrays(arm))
    moving = np.flatnonzero(found.links > 0)
    round_groups = moved(arm.link_frames(rows)[:, found.links], found.spheres_m[:, :3])

    def are_hit(spheres: NDArray[np.float64], own: NDArray[np.float64]) -> NDArray[np.bool_]:
        held = np.ascontiguousarray(spheres)
        return np.asarray(~sets_are_free(held, own.copy(), stood.boxes, stood.cylinders))

    hits = np.zeros((len(rows), len(moving)), dtype=np.bool_)
    for column, number in enumerate(moving):
        # Few of the spheres that hold a group are near anything.
        perhaps = are_hit(round_groups[:, number, None], found.spheres_m[number, 3:])
        members = np.flatnonzero(found.groups == number)
        hits[perhaps, column] = are_hit(centres[perhaps][:, members], radii[members])
    return hits


# That is kept to what is seen; the most careful first.
MARGINS_M = (0.015, 0.005, 0.0)
# More than what lies between the centres of neighbouring voxels.
_ROOM_M = 0.035
_NO_OBSTACLES = Obstacles((), ())


def seen_checkers(
    world: SpatialWorld,
    picture: NDArray[np.uint8],
    ends: NDArray[np.float64],
    obstacles: Obstacles = _NO_OBSTACLES,
) -> list[CollisionChecker]:
    """See :func:`cspace.worlds.seen_checkers`; distances are those of the picture's voxels.

    Obstacles are known to stand there, too, whatever the picture shows.
    """
    arm, grid = world.body, world.sensor.grid
    arrays = arm_arrays(arm)
    moving = arrays.links > 0
    centres = sphere_centres_batch(np.ascontiguousarray(ends, dtype=np.float64), arrays)[:, moving]
    radii = np.tile(arrays.radii[moving], len(centres))
    found = []
    for margin_m in MARGINS_M:
        known = distance_grid(distances_m(picture) - np.float32(margin_m), grid.low_m, grid.voxel_m)
        clear_spheres(known, centres.reshape(-1, 3), radii, _ROOM_M)
        found.append(CollisionChecker(arm, obstacles, known))
    return found
