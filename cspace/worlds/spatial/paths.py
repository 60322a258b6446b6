"""Short free paths of a serial arm among obstacles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from cspace.planning.kernels import gap
from cspace.planning.paths import length_rad, spaced
from cspace.planning.rrt_connect import connect_trees
from cspace.worlds.spatial.checks import CollisionChecker, checked_edge, room_of

# Shares of the length below which shortcuts are not drawn, and gains below which they are not looked at.
_SHORTEST, _LEAST_GAIN = 0.02, 1e-4
_SAME_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class PathLimits:
    """How long and how finely ways are searched for.

    Args:
        states: uniform ones that the first try draws at most; the others draw a quarter of them.
        tries: ways that the shortest is chosen from; fewer where one of the others fails.
        shortcuts: proposed for each of them.
        polish: proposed for the shortest.
        range_rad: longest step of a tree, the sum over the joints.
        search_rad: between states that the trees look at, the largest over the joints.
        shortcut_rad: the same for shortcuts; finer than what is returned, which touches nothing then.
        final_rad: the same for what is returned.
        step_rad: longest step of what is returned, Euclidean.

    Raises:
        ScenarioError: a count is negative or a distance is not above 0.
    """

    states: int = 16000
    tries: int = 6
    shortcuts: int = 40
    polish: int = 200
    range_rad: float = 2.0
    search_rad: float = 0.02
    shortcut_rad: float = 0.005
    final_rad: float = 0.01
    step_rad: float = 0.1

    def __post_init__(self) -> None:
        counts = min(self.states, self.tries, self.shortcuts, self.polish) >= 0
        steps = (self.range_rad, self.search_rad, self.shortcut_rad, self.final_rad, self.step_rad)
        if not counts or not all(0.0 < one < np.inf for one in steps):
            raise ScenarioError(
                "the limits of a search for ways do not fit",
                expected="counts of 0 or more and steps above 0 rad",
                got=str(self)[:300],
            )


def find_path(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike,
    rng: np.random.Generator,
    limits: PathLimits = PathLimits(),
) -> NDArray[np.float64] | None:
    """A short free way, or None where none is found.

    Args:
        checker: of the scene.
        start: (d,) rad, the first row of the way, circles in [-pi, pi).
        goal: (d,) rad, likewise the last row.
        rng: draws states and shortcuts.
        limits: effort and resolutions.

    Returns:
        (k, d) rad, every edge free at ``limits.final_rad``; the straight way where it is free.

    Raises:
        ScenarioError: start or goal is of another shape.
    """
    if not (checker.valid(start) and checker.valid(goal)):
        return None
    ends = checker.space.wrap(np.stack([np.asarray(one, dtype=np.float64) for one in (start, goal)]))
    straight = _checked(checker, ends, limits)
    if straight is not None:
        return straight
    found: list[NDArray[np.float64]] = []
    for index in range(limits.tries):
        states = limits.states if index == 0 else limits.states // 4
        raw = _raw_way(checker, ends, rng, limits, states)
        if raw is None:
            break
        short = shorten(checker, raw, rng, limits.shortcuts, limits.shortcut_rad)
        found += [way for way in (short, raw) if is_free(checker, way, limits.final_rad)][:1]
    for way in sorted(found, key=lambda one: length_rad(one, checker.space)):
        polished = shorten(checker, way, rng, limits.polish, limits.shortcut_rad)
        for one in (polished, way):
            spaced = _checked(checker, one, limits)
            if spaced is not None:
                return spaced
    return None


def _raw_way(
    checker: CollisionChecker,
    ends: NDArray[np.float64],
    rng: np.random.Generator,
    limits: PathLimits,
    count: int,
) -> NDArray[np.float64] | None:
    """What RRT-Connect finds with so many uniform states."""
    states = checker.space.sample_uniform(rng, count)
    return connect_trees(
        checker, ends[0], ends[1], states, range_rad=limits.range_rad, resolution_rad=limits.search_rad
    )


def shorten(
    checker: CollisionChecker,
    way: ArrayLike,
    rng: np.random.Generator,
    shortcuts: int,
    resolution_rad: float,
) -> NDArray[np.float64]:
    """The way with straight pieces between random points of it wherever these are free and shorter.

    Args:
        checker: of the scene.
        way: (k, d) rad, k at least 2.
        rng: draws the points.
        shortcuts: how many are proposed.
        resolution_rad: between the states that are looked at, the largest over the joints.

    Returns:
        (n, d) rad with the same ends, no longer than before.

    Raises:
        ScenarioError: the way is of another shape, or the resolution is not above 0.
    """
    rows = np.array(way, dtype=np.float64)
    if rows.ndim != 2 or len(rows) < 2 or rows.shape[1] != checker.arm.dim or not resolution_rad > 0.0:
        raise ScenarioError(
            "the way does not fit",
            expected=f"two or more configurations of {checker.arm.dim} joints, and a positive resolution",
            got=f"shape {rows.shape}, {resolution_rad} rad",
        )
    draws = rng.random((shortcuts, 2))
    # Spans of all sizes: corners are cut by short ones, detours by long ones.
    draws[:, 1] = _SHORTEST ** draws[:, 1]
    found: NDArray[np.float64] = _shortened(rows, draws, resolution_rad, checker.scene)
    return found


def is_free(checker: CollisionChecker, way: NDArray[np.float64], resolution_rad: float) -> bool:
    """Whether all edges of a way (k, d) rad are free."""
    return bool(checker.edge_batch(way[:-1], way[1:], resolution_rad).all())


def _checked(
    checker: CollisionChecker, way: NDArray[np.float64], limits: PathLimits
) -> NDArray[np.float64] | None:
    """The way in even steps, None where one of these is not free."""
    found = spaced(way, checker.space, limits.step_rad)
    return found if is_free(checker, found, limits.final_rad) else None


@njit(cache=True, nogil=True, error_model="numpy")
def _shortened(way, draws, resolution, scene):  # type: ignore[no-untyped-def]
    """The way after shortcuts (N, 2): where each begins and its span, as shares of the length."""
    room, periodic = room_of(scene), scene.periodic
    now, count = np.empty((way.shape[0] + draws.shape[0], way.shape[1])), way.shape[0]
    now[:count] = way
    reached, first, last = np.zeros(now.shape[0]), np.empty(way.shape[1]), np.empty(way.shape[1])
    for index in range(draws.shape[0]):
        for node in range(1, count):
            reached[node] = reached[node - 1] + _distance(now[node - 1], now[node], periodic)
        whole = reached[count - 1]
        span = draws[index, 1] * whole
        begin = draws[index, 0] * (whole + span) - span
        begin, end = max(begin, 0.0), min(begin + span, whole)
        i = _point(now, count, reached, begin, periodic, first)
        j = _point(now, count, reached, end, periodic, last)
        gain = end - begin - _distance(first, last, periodic)
        if i == j or gain < _LEAST_GAIN * whole or not checked_edge(first, last, resolution, scene, room)[0]:
            continue
        rest, at = now[j + 1 : count].copy(), i + 1
        for point, node in ((first, now[i]), (last, rest[0])):
            # A point at a node is that node.
            if _distance(point, node, periodic) > _SAME_RAD:
                now[at] = point
                at += 1
        count = at + rest.shape[0]
        now[at:count] = rest
    return now[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _point(way, count, reached, along, periodic, out):  # type: ignore[no-untyped-def]
    """Fill in the point at a distance along the way; the edge that it lies on."""
    edge = 0
    while edge < count - 2 and reached[edge + 1] < along:
        edge += 1
    length = reached[edge + 1] - reached[edge]
    share = min(max((along - reached[edge]) / length, 0.0), 1.0) if length > 0.0 else 0.0
    for joint in range(way.shape[1]):
        out[joint] = way[edge, joint] + share * gap(way[edge, joint], way[edge + 1, joint], periodic[joint])
    return edge


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(first, second, periodic):  # type: ignore[no-untyped-def]
    square = 0.0
    for joint in range(first.shape[0]):
        square += gap(first[joint], second[joint], periodic[joint]) ** 2
    return np.sqrt(square)
