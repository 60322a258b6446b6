"""Collision checks of an arm among discs: numba kernels, and the checker of a scene or of a picture."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from cspace.simulator import EdgeTest, StateTest
from cspace.space import JointSpace
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.world import PlanarWorld, Scenario

TWO_PI = 2.0 * np.pi
# Sine of the angle up to which two lines count as parallel.
_PARALLEL = 1e-9


@njit(cache=True, nogil=True)
def segment_gap(ax, ay, bx, by, cx, cy, dx, dy):  # type: ignore[no-untyped-def]
    """Distance between the segments from a to b and from c to d; 0 where they cross.

    Those that do not cross are nearest at an end of one of them.
    """
    ux, uy, vx, vy = bx - ax, by - ay, dx - cx, dy - cy
    turn = ux * vy - uy * vx
    # Rounding lets parallel lines cross anywhere, and their ends tell the distance anyway.
    if turn * turn > (_PARALLEL * _PARALLEL) * (ux * ux + uy * uy) * (vx * vx + vy * vy):
        first = ((cx - ax) * vy - (cy - ay) * vx) / turn
        second = ((cx - ax) * uy - (cy - ay) * ux) / turn
        if 0.0 <= first <= 1.0 and 0.0 <= second <= 1.0:
            return 0.0
    from_first = min(_point_gap(ax, ay, cx, cy, dx, dy), _point_gap(bx, by, cx, cy, dx, dy))
    from_second = min(_point_gap(cx, cy, ax, ay, bx, by), _point_gap(dx, dy, ax, ay, bx, by))
    return min(from_first, from_second)


@njit(cache=True, nogil=True)
def _point_gap(px, py, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Distance of a point to the segment from a to b."""
    dx, dy = bx - ax, by - ay
    along = ((px - ax) * dx + (py - ay) * dy) / (dx * dx + dy * dy)
    along = min(1.0, max(0.0, along))
    return np.hypot(px - ax - along * dx, py - ay - along * dy)


@njit(cache=True, nogil=True)
def self_clearance(q, links, half_width, pairs):  # type: ignore[no-untyped-def]
    """Smallest distance between the capsules of the links of a pair, m."""
    count = links.shape[0]
    x, y, heading = np.zeros(count + 1), np.zeros(count + 1), 0.0
    for joint in range(count):
        heading += q[joint]
        x[joint + 1] = x[joint] + links[joint] * np.cos(heading)
        y[joint + 1] = y[joint] + links[joint] * np.sin(heading)
    least = np.inf
    for pair in range(pairs.shape[0]):
        i, j = pairs[pair, 0], pairs[pair, 1]
        gap = segment_gap(x[i], y[i], x[i + 1], y[i + 1], x[j], y[j], x[j + 1], y[j + 1])
        least = min(least, gap)
    return least - 2.0 * half_width


@njit(cache=True, nogil=True)
def arm_clearance(q, links, half_width, discs, pairs):  # type: ignore[no-untyped-def]
    """Smallest distance between the arm's capsules and the discs, m; inf without discs.

    No more than that between the capsules of the links of a pair.
    """
    clearance = np.inf
    if pairs is not None:
        clearance = self_clearance(q, links, half_width, pairs)
    x0, y0, heading = 0.0, 0.0, 0.0
    for joint in range(links.shape[0]):
        heading += q[joint]
        dx, dy = links[joint] * np.cos(heading), links[joint] * np.sin(heading)
        for disc in range(discs.shape[0]):
            px, py = discs[disc, 0] - x0, discs[disc, 1] - y0
            along = (px * dx + py * dy) / (dx * dx + dy * dy)
            along = min(1.0, max(0.0, along))
            gap = np.hypot(px - along * dx, py - along * dy) - discs[disc, 2] - half_width
            clearance = min(clearance, gap)
        x0 += dx
        y0 += dy
    return clearance


@njit(cache=True, nogil=True)
def arm_is_free(q, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether one configuration (d,) is within its limits, clear of every disc and of itself."""
    for joint in range(links.shape[0]):
        if not periodic[joint] and not lower[joint] <= q[joint] <= upper[joint]:
            return False
    return arm_clearance(q, links, half_width, discs, pairs) > 0.0


@njit(cache=True, nogil=True)
def checked_edge(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped segment from ``a`` to ``b`` is free, and how many states were looked at.

    Both ends are included. Neighbouring states are at most ``resolution`` rad apart in every joint. They are
    looked at in the order of a bisection, which finds collisions sooner and changes no result.
    """
    dim = links.shape[0]
    step = np.empty(dim)
    longest = 0.0
    for joint in range(dim):
        step[joint] = b[joint] - a[joint]
        if periodic[joint]:
            step[joint] = (step[joint] + np.pi) % TWO_PI - np.pi
        longest = max(longest, abs(step[joint]))
    count = max(1, int(np.ceil(longest / resolution)))
    q = np.empty(dim)
    stride = 1
    while stride < count:
        stride *= 2
    first, looked = True, 0
    while stride >= 1:
        start, jump = (0, stride) if first else (stride, 2 * stride)
        for index in range(start, count + 1, jump):
            for joint in range(dim):
                q[joint] = a[joint] + step[joint] * index / count
            looked += 1
            if not arm_is_free(q, links, half_width, discs, pairs, lower, upper, periodic):
                return False, looked
        first = False
        stride //= 2
    for joint in range(dim):
        q[joint] = a[joint] + step[joint]
    return arm_is_free(q, links, half_width, discs, pairs, lower, upper, periodic), looked + 1


@njit(cache=True, nogil=True)
def edge_is_free(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped segment from ``a`` to ``b`` is free, both ends included."""
    return checked_edge(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic)[0]


@njit(cache=True, nogil=True)
def clearance_batch(q, links, half_width, discs, pairs):  # type: ignore[no-untyped-def]
    """Clearance of each of (N, d), (N,) m."""
    out = np.empty(q.shape[0])
    for row in range(q.shape[0]):
        out[row] = arm_clearance(q[row], links, half_width, discs, pairs)
    return out


@njit(cache=True, nogil=True)
def free_batch(q, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Which of (N, d) are free, (N,)."""
    out = np.empty(q.shape[0], dtype=np.bool_)
    for row in range(q.shape[0]):
        out[row] = arm_is_free(q[row], links, half_width, discs, pairs, lower, upper, periodic)
    return out


@njit(cache=True, nogil=True)
def edge_batch(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Which segments between (N, d) and (N, d) are free, (N,)."""
    out = np.empty(a.shape[0], dtype=np.bool_)
    for row in range(a.shape[0]):
        out[row] = edge_is_free(
            a[row], b[row], resolution, links, half_width, discs, pairs, lower, upper, periodic
        )
    return out


_TRAPPED, _ADVANCED, _REACHED = 0, 1, 2


@njit(cache=True, nogil=True)
def advance(  # type: ignore[no-untyped-def]
    nodes, parents, counts, checks, states, side, reach, resolution,
    links, half_width, discs, pairs, lower, upper, periodic,
):  # fmt: skip
    """Grow by a block of states: iterations, whose turn it is, the shared node or -1 twice.

    ``checks`` counts on: edges, and states within them and alone.
    """
    for index in range(states.shape[0]):
        other = 1 - side
        status = _grow(
            nodes, parents, counts, checks, side, states[index], reach, resolution,
            links, half_width, discs, pairs, lower, upper, periodic,
        )  # fmt: skip
        if status != _TRAPPED:
            target = nodes[side, counts[side] - 1].copy()
            status = _ADVANCED
            while status == _ADVANCED:
                status = _grow(
                    nodes, parents, counts, checks, other, target, reach, resolution,
                    links, half_width, discs, pairs, lower, upper, periodic,
                )  # fmt: skip
            if status == _REACHED:
                first, second = counts[0] - 1, counts[1] - 1
                return index + 1, other, first, second
        side = other
    return states.shape[0], side, -1, -1


@njit(cache=True, nogil=True)
def _grow(  # type: ignore[no-untyped-def]
    nodes, parents, counts, checks, side, target, reach, resolution,
    links, half_width, discs, pairs, lower, upper, periodic,
):  # fmt: skip
    """One step of a tree towards a configuration: trapped, advanced or reached."""
    dim = target.shape[0]
    if counts[side] == nodes.shape[1]:
        return _TRAPPED
    nearest, least = _nearest(nodes[side], counts[side], target, periodic)
    share = min(1.0, reach / least) if least > 0.0 else 1.0
    new = np.empty(dim)
    for joint in range(dim):
        begin = nodes[side, nearest, joint]
        new[joint] = begin + share * _gap(begin, target[joint], periodic[joint])
        if periodic[joint]:
            new[joint] = (new[joint] + np.pi) % TWO_PI - np.pi
    if share == 1.0:
        new[:] = target
    # The goal's tree looks at the new state before its edge, as OMPL's does.
    if side == 1:
        checks[1] += 1
        if not arm_is_free(new, links, half_width, discs, pairs, lower, upper, periodic):
            return _TRAPPED
    free, states = checked_edge(
        nodes[side, nearest], new, resolution,
        links, half_width, discs, pairs, lower, upper, periodic,
    )  # fmt: skip
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
            distance += abs(_gap(nodes[node, joint], target[joint], periodic[joint]))
        if distance < least:
            nearest, least = node, distance
    return nearest, least


@njit(cache=True, nogil=True)
def _gap(begin, end, wraps):  # type: ignore[no-untyped-def]
    """The way from one angle to another, the shorter one on a circle."""
    gap = end - begin
    return (gap + np.pi) % TWO_PI - np.pi if wraps else gap


class CollisionChecker:
    """Exact collision checks for one scenario.

    ``kernel_args`` are the arguments that the raw kernels :func:`arm_is_free` and :func:`edge_is_free` take
    after their own.
    """

    def __init__(self, scenario: Scenario) -> None:
        space = scenario.robot.space
        self.scenario = scenario
        self.kernel_args: tuple[Any, ...] = (
            np.asarray(scenario.robot.link_lengths_m, dtype=np.float64),
            float(scenario.robot.half_width_m),
            scenario.disc_array,
            _pairs(scenario.robot),
            np.asarray(space.lower, dtype=np.float64),
            np.asarray(space.upper, dtype=np.float64),
            np.asarray(space.periodic, dtype=np.bool_),
        )

    @property
    def space(self) -> JointSpace:
        """The arm's joint space."""
        return self.scenario.robot.space

    def valid(self, configuration: ArrayLike) -> bool:
        """Whether one configuration (d,) rad is free."""
        return bool(self.valid_batch(np.atleast_2d(np.asarray(configuration, dtype=np.float64)))[0])

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""
        result: NDArray[np.bool_] = free_batch(self._rows(configurations), *self.kernel_args)
        return result

    def clearance(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Distance from arm to discs, or to itself, for each of (N, d) rad, (N,) m; negative in collision."""
        result: NDArray[np.float64] = clearance_batch(self._rows(configurations), *self.kernel_args[:4])
        return result

    def edge(self, start: ArrayLike, end: ArrayLike, resolution_rad: float) -> bool:
        """Whether the straight wrapped segment between two configurations (d,) is free."""
        start, end = (np.atleast_2d(np.asarray(q, dtype=np.float64)) for q in (start, end))
        return bool(self.edge_batch(start, end, resolution_rad)[0])

    def edge_batch(self, starts: ArrayLike, ends: ArrayLike, resolution_rad: float) -> NDArray[np.bool_]:
        """Which of the segments between (N, d) and (N, d) are free, (N,).

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
        result: NDArray[np.bool_] = edge_batch(first, second, float(resolution_rad), *self.kernel_args)
        return result

    def state_test(self) -> StateTest:
        """See :meth:`cspace.simulator.Checker.state_test`."""
        arguments = self.kernel_args

        def is_free(configuration: NDArray[np.float64]) -> bool:
            return bool(arm_is_free(configuration, *arguments))

        # A process's first call loads the compiled kernel, which is no part of a search.
        is_free(np.zeros(self.scenario.robot.dim))
        return is_free

    def edge_test(self, resolution_rad: float) -> EdgeTest:
        """See :meth:`cspace.simulator.Checker.edge_test`."""
        arguments = (resolution_rad, *self.kernel_args)

        def check(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[bool, int]:
            found: tuple[bool, int] = checked_edge(start, end, *arguments)
            return found

        check(np.zeros(self.scenario.robot.dim), np.zeros(self.scenario.robot.dim))
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
        """See :func:`cspace.worlds.planar.checks.advance`."""
        grown: tuple[int, int, int, int] = advance(
            nodes, parents, counts, checks, states, side, range_rad, resolution_rad, *self.kernel_args
        )
        return grown

    def _rows(self, configurations: ArrayLike) -> NDArray[np.float64]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.scenario.robot.dim:
            raise ScenarioError(
                "the configurations do not fit the robot",
                expected=f"shape (N, {self.scenario.robot.dim})",
                got=str(rows.shape),
            )
        return rows


def _pairs(robot: PlanarArm) -> NDArray[np.int64] | None:
    """The links that collide with each other, (K, 2); None where none do."""
    if not robot.self_collision or robot.dim < 3:
        return None
    return np.argwhere(np.triu(np.ones((robot.dim, robot.dim)), 2)).astype(np.int64)


# Of a pixel's side, that obstacles are taken to be larger; the most careful first.
MARGINS = (0.5, 0.0, -0.25)
# Of a pixel, from which on it counts as covered.
_COVERED = 0.25
# Blue of the picture where a pixel is wholly covered, and where it is not covered.
_GROUND = 255.0


def seen_checkers(
    world: PlanarWorld, picture: NDArray[np.uint8], ends: NDArray[np.float64]
) -> list[CollisionChecker]:
    """See :func:`cspace.worlds.seen_checkers`; covered pixels are discs of their area."""
    camera, arm = world.sensor, world.body
    # Red discs lie over the blue arm and the white ground.
    covered = 1.0 - picture[..., 2] / _GROUND
    rows, columns = np.nonzero(_outline(covered >= _COVERED))
    height, width = (side / camera.pixels for side in _sides(camera.extent_m))
    left, _, _, top = camera.extent_m
    places = np.stack([left + (columns + 0.5) * width, top - (rows + 0.5) * height], axis=1)
    radii = np.sqrt(covered[rows, columns] * width * height / np.pi)
    room = _distances(arm.joint_positions_m(ends), places) - arm.half_width_m
    found = []
    for margin in MARGINS:
        sizes = np.minimum(radii + margin * width, 0.99 * room)
        discs = np.column_stack([places, sizes])[sizes > 0.0]
        found.append(CollisionChecker(Scenario.from_array(arm, discs, camera)))
    return found


def _sides(extent_m: tuple[float, float, float, float]) -> tuple[float, float]:
    """Height and width, m."""
    left, right, bottom, top = extent_m
    return top - bottom, right - left


def _outline(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those that are not surrounded by others: an arm that touches an inner one touches these before."""
    framed = np.pad(covered, 1, constant_values=False)
    inner = framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return covered & ~inner


def _distances(joints: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of places (n, 2) to the nearest of the arms' links (k, j, 2), (n,) m."""
    begins, ends = joints[:, :-1].reshape(-1, 2), joints[:, 1:].reshape(-1, 2)
    along = ends - begins
    apart = places[:, None] - begins
    shares = np.clip((apart * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    found: NDArray[np.float64] = np.linalg.norm(apart - shares[..., None] * along, axis=2).min(axis=1)
    return found
