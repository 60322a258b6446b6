"""Forward kinematics, self-collision and inverse kinematics of a serial arm, compiled."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.planning.kernels import gap
from cspace.space import JointSpace
from cspace.worlds.spatial.arm import SerialArm, joint_arrays


class ArmArrays(NamedTuple):
    """A serial arm of d joints, S spheres, P parts and K pairs as the kernels take it."""

    origins: NDArray[np.float64]  # (d, 4, 4) joints' frames in those of the links before them
    axes: NDArray[np.float64]  # (d, 3) unit vectors
    links: NDArray[np.int64]  # (S,) the link of each sphere
    centres: NDArray[np.float64]  # (S, 3) in the link's frame, m
    radii: NDArray[np.float64]  # (S,) m
    ranges: NDArray[np.int64]  # (P, 2) first sphere of each part, and the one after its last
    bound_links: NDArray[np.int64]  # (P,) the link of each part
    bound_centres: NDArray[np.float64]  # (P, 3) of a sphere round the part, in the link's frame, m
    bound_radii: NDArray[np.float64]  # (P,) m
    pairs: NDArray[np.int64]  # (K, 2) parts that can touch
    overlaps: NDArray[np.float64]  # (K,) m, by which the spheres of a pair may overlap


@lru_cache(maxsize=16)
def arm_arrays(arm: SerialArm) -> ArmArrays:
    """The arrays of an arm."""
    spheres = arm.spheres_m()
    numbers = {part.name: index for index, part in enumerate(arm.parts)}
    pairs = [(numbers[first], numbers[second]) for first, second in arm.touching]
    bounds = [_bound(np.asarray(part.spheres_m)) for part in arm.parts]
    origins, axes = joint_arrays(arm)
    overlaps: list[Any] = [part.overlap_m for part in arm.parts]
    return ArmArrays(
        origins=origins,
        axes=axes,
        links=arm.sphere_links(),
        centres=np.ascontiguousarray(spheres[:, :3]),
        radii=np.ascontiguousarray(spheres[:, 3]),
        ranges=arm.sphere_ranges(),
        bound_links=np.asarray([part.link for part in arm.parts], dtype=np.int64),
        bound_centres=np.asarray([centre for centre, _ in bounds]).reshape(-1, 3),
        bound_radii=np.asarray([radius for _, radius in bounds], dtype=np.float64),
        pairs=np.asarray(pairs, dtype=np.int64).reshape(-1, 2),
        overlaps=np.asarray(
            [0.0 if None in (overlaps[i], overlaps[j]) else overlaps[i] + overlaps[j] for i, j in pairs]
        ),
    )


def _bound(spheres: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    centres, radii = spheres[:, :3], spheres[:, 3:]
    middle = ((centres - radii).min(axis=0) + (centres + radii).max(axis=0)) / 2.0
    return middle, float((np.linalg.norm(centres - middle, axis=1) + radii[:, 0]).max())


@njit(cache=True, nogil=True)
def link_frames_into(q, origins, axes, frames):  # type: ignore[no-untyped-def]
    """Forward kinematics of one configuration (d,): the links' frames, (d + 1, 4, 4)."""
    for row in range(4):
        for column in range(4):
            frames[0, row, column] = 1.0 if row == column else 0.0
    for joint in range(q.shape[0]):
        x, y, z = axes[joint, 0], axes[joint, 1], axes[joint, 2]
        c, s = np.cos(q[joint]), np.sin(q[joint])
        v = 1.0 - c
        before, after, origin = frames[joint], frames[joint + 1], origins[joint]
        for row in range(3):
            a, b, e = before[row, 0], before[row, 1], before[row, 2]
            i = a * origin[0, 0] + b * origin[1, 0] + e * origin[2, 0]
            j = a * origin[0, 1] + b * origin[1, 1] + e * origin[2, 1]
            k = a * origin[0, 2] + b * origin[1, 2] + e * origin[2, 2]
            after[row, 3] = a * origin[0, 3] + b * origin[1, 3] + e * origin[2, 3] + before[row, 3]
            after[row, 0] = i * (x * x * v + c) + j * (x * y * v + z * s) + k * (x * z * v - y * s)
            after[row, 1] = i * (x * y * v - z * s) + j * (y * y * v + c) + k * (y * z * v + x * s)
            after[row, 2] = i * (x * z * v + y * s) + j * (y * z * v - x * s) + k * (z * z * v + c)
        for column in range(4):
            after[3, column] = 1.0 if column == 3 else 0.0


@njit(cache=True, nogil=True)
def points_into(frames, links, points, out):  # type: ignore[no-untyped-def]
    """Points (S, 3) of the links that they are fixed to, in the base's frame, (S, 3) m."""
    for index in range(points.shape[0]):
        frame = frames[links[index]]
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        for row in range(3):
            out[index, row] = frame[row, 0] * x + frame[row, 1] * y + frame[row, 2] * z + frame[row, 3]


@njit(cache=True, nogil=True)
def self_distance(centres, bounds, arm, least):  # type: ignore[no-untyped-def]
    """Signed distance of the closest spheres (S, 3) of parts that can touch, m, or ``least``."""
    for pair in range(arm.pairs.shape[0]):
        i, j = arm.pairs[pair, 0], arm.pairs[pair, 1]
        if _gap(bounds, arm.bound_radii, i, bounds, arm.bound_radii, j) >= least:
            continue
        for first in range(arm.ranges[i, 0], arm.ranges[i, 1]):
            if _gap(centres, arm.radii, first, bounds, arm.bound_radii, j) >= least:
                continue
            for second in range(arm.ranges[j, 0], arm.ranges[j, 1]):
                apart = _gap(centres, arm.radii, first, centres, arm.radii, second)
                least = min(least, apart + arm.overlaps[pair])
    return least


@njit(cache=True, nogil=True)
def _gap(first, first_radii, i, second, second_radii, j):  # type: ignore[no-untyped-def]
    x, y, z = first[i, 0] - second[j, 0], first[i, 1] - second[j, 1], first[i, 2] - second[j, 2]
    return np.sqrt(x * x + y * y + z * z) - first_radii[i] - second_radii[j]


@njit(cache=True, nogil=True)
def sphere_centres_batch(q, arm):  # type: ignore[no-untyped-def]
    """Forward kinematics: (N, d) rad to the spheres' centres in the base's frame, (N, S, 3) m."""
    out = np.empty((q.shape[0], arm.centres.shape[0], 3))
    frames = np.empty((q.shape[1] + 1, 4, 4))
    for row in range(q.shape[0]):
        link_frames_into(q[row], arm.origins, arm.axes, frames)
        points_into(frames, arm.links, arm.centres, out[row])
    return out


_ANY, _ALONG, _FULL = 0, 1, 2
# What an angle of 1 rad weighs beside places, m.
_LEVER_M = 0.3
_LEAST_DAMPING = 1e-6
# Steps of :func:`aligned`, most.
_ALIGNING = 20


@dataclass(frozen=True, slots=True)
class Solving:
    """How poses are solved for."""

    starts: int = 16
    iterations: int = 60
    place_m: float = 0.001
    turn_rad: float = 0.0174  # largest angle between the tool's rotation, or z axis, and its goal's
    distinct_rad: float = 0.1


class _Chain(NamedTuple):
    """An arm of d joints as the kernels take it: frames and axes of the joints, the tool, limits."""

    origins: NDArray[np.float64]
    axes: NDArray[np.float64]
    tool: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    periodic: NDArray[np.bool_]


def solve_pose(
    arm: SerialArm,
    place_m: ArrayLike,
    rng: np.random.Generator,
    *,
    approach: ArrayLike | None = None,
    rotation: ArrayLike | None = None,
    solving: Solving = Solving(),
    space: JointSpace | None = None,
) -> NDArray[np.float64]:
    """Configurations (n, d) rad that bring the tool to a place (3,) m, obstacles and self-collision aside.

    ``approach``: (3,) along which the tool's z axis shall point. ``rotation``: (3, 3) of the tool instead;
    with neither any will do. ``space``: with narrower limits than the arm's.
    """
    place, wanted, mode = np.array(place_m, dtype=np.float64), np.eye(3), _ANY
    if approach is not None:
        wanted[:, 2], mode = approach, _ALONG
    elif rotation is not None:
        wanted, mode = np.array(rotation, dtype=np.float64), _FULL
    space = arm.space if space is None else space
    chain = _chain(arm, space, arm.tool.matrix())
    tolerance = (solving.place_m, solving.turn_rad, solving.distinct_rad)
    starts = space.sample_uniform(rng, solving.starts)
    found: NDArray[np.float64] = _solve_all(starts, place, wanted, mode, chain, solving.iterations, tolerance)
    return space.wrap(found)


def aligned(
    arm: SerialArm,
    configurations: ArrayLike,
    axis: ArrayLike,
    along: ArrayLike,
    within_rad: float,
    space: JointSpace,
) -> NDArray[np.float64]:
    """Configurations (N, d) rad changed until an axis of the last link points along one of the base."""
    frame, wanted = np.eye(4), np.eye(3)
    frame[:3, 2], wanted[:, 2] = axis, along
    rows = np.array(configurations, dtype=np.float64)
    _align_all(rows, wanted, _chain(arm, space, frame), _ALIGNING, float(within_rad))
    return space.wrap(rows)


def _chain(arm: SerialArm, space: JointSpace, tool: NDArray[np.float64]) -> _Chain:
    origins, axes = joint_arrays(arm)
    return _Chain(origins, axes, tool, *limit_arrays(space))


def limit_arrays(space: JointSpace) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Lower and upper ends of the joints' ranges, (d,) rad, and which joints are circles."""
    lower, upper = (np.asarray(ends, dtype=np.float64) for ends in (space.lower, space.upper))
    return lower, upper, np.asarray(space.periodic, dtype=np.bool_)


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_all(starts, place, wanted, mode, chain, iterations, tolerance):  # type: ignore[no-untyped-def]
    """Distinct solutions (n, d) from starts (N, d)."""
    dim = starts.shape[1]
    found, count = np.empty(starts.shape), 0
    frames, jacobian, error = np.empty((dim + 1, 4, 4)), np.empty((6, dim)), np.empty(6)
    for index in range(starts.shape[0]):
        q = starts[index].copy()
        solved = False
        for _ in range(iterations):
            link_frames_into(q, chain.origins, chain.axes, frames)
            away, turn = _errors(chain, frames, place, wanted, mode, jacobian, error)
            if away <= tolerance[0] and turn <= tolerance[1]:
                solved = True
                break
            _step(q, jacobian, error, chain)
        if not solved:
            continue
        distinct = True
        for other in range(count):
            widest = 0.0
            for joint in range(dim):
                widest = max(widest, abs(gap(found[other, joint], q[joint], chain.periodic[joint])))
            distinct = distinct and widest > tolerance[2]
        if distinct:
            found[count] = q
            count += 1
    return found[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _align_all(rows, wanted, chain, iterations, within):  # type: ignore[no-untyped-def]
    """Turn rows (N, d) in place, wherever that takes the tool."""
    dim, place = rows.shape[1], np.zeros(3)
    frames, jacobian, error = np.empty((dim + 1, 4, 4)), np.empty((6, dim)), np.empty(6)
    for index in range(rows.shape[0]):
        for _ in range(iterations):
            link_frames_into(rows[index], chain.origins, chain.axes, frames)
            if _errors(chain, frames, place, wanted, _ALONG, jacobian, error)[1] <= within:
                break
            error[:3], jacobian[:3] = 0.0, 0.0
            _step(rows[index], jacobian, error, chain)


@njit(cache=True, nogil=True, error_model="numpy")
def _errors(chain, frames, place, wanted, mode, jacobian, error):  # type: ignore[no-untyped-def]
    """Fill the error (6,) and its Jacobian (6, d), turns weighed; how far off the tool is, m and rad."""
    now, axes = frames[-1] @ chain.tool, chain.axes
    for row in range(3):
        error[row] = place[row] - now[row, 3]
    away = np.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
    turn = _turn_error(now, wanted, mode, error)
    z0, z1, z2 = now[0, 2], now[1, 2], now[2, 2]
    for joint in range(axes.shape[0]):
        frame, axis = frames[joint + 1], axes[joint]
        x = frame[0, 0] * axis[0] + frame[0, 1] * axis[1] + frame[0, 2] * axis[2]
        y = frame[1, 0] * axis[0] + frame[1, 1] * axis[1] + frame[1, 2] * axis[2]
        z = frame[2, 0] * axis[0] + frame[2, 1] * axis[1] + frame[2, 2] * axis[2]
        u, v, w = now[0, 3] - frame[0, 3], now[1, 3] - frame[1, 3], now[2, 3] - frame[2, 3]
        jacobian[0, joint], jacobian[1, joint], jacobian[2, joint] = (
            y * w - z * v,
            z * u - x * w,
            x * v - y * u,
        )
        if mode == _ANY:
            x, y, z = 0.0, 0.0, 0.0
        elif mode == _ALONG:
            # Turns about the tool's own z axis are free.
            own = x * z0 + y * z1 + z * z2
            x, y, z = x - own * z0, y - own * z1, z - own * z2
        jacobian[3, joint], jacobian[4, joint], jacobian[5, joint] = x * _LEVER_M, y * _LEVER_M, z * _LEVER_M
    return away, turn


@njit(cache=True, nogil=True, error_model="numpy")
def _turn_error(now, wanted, mode, error):  # type: ignore[no-untyped-def]
    """Fill the rotation vector, weighed, into ``error[3:]``; its angle, rad."""
    x, y, z, cosine = 0.0, 0.0, 0.0, 1.0
    if mode != _ANY:
        # Half the sum of the cross products of the axes is the sine times the axis of the rotation.
        first, share = (2, 1.0) if mode == _ALONG else (0, 0.5)
        cosine = 0.0 if mode == _ALONG else -0.5
        for column in range(first, 3):
            a, b, c = now[0, column], now[1, column], now[2, column]
            i, j, k = wanted[0, column], wanted[1, column], wanted[2, column]
            x, y, z = x + share * (b * k - c * j), y + share * (c * i - a * k), z + share * (a * j - b * i)
            cosine += share * (a * i + b * j + c * k)
    sine = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, cosine)
    if sine < 1e-9 and cosine < 0.0:
        # Half a turn about any axis; the tool's own x leads away from it.
        x, y, z, sine = now[0, 0], now[1, 0], now[2, 0], 1.0
    scale = _LEVER_M * angle / sine if sine > 0.0 else 0.0
    error[3], error[4], error[5] = x * scale, y * scale, z * scale
    return angle


@njit(cache=True, nogil=True, error_model="numpy")
def _step(q, jacobian, error, chain):  # type: ignore[no-untyped-def]
    """One step of damped least squares, cut off at the limits."""
    dim, lower, upper, periodic = q.shape[0], chain.lower, chain.upper, chain.periodic
    square = 0.0
    for row in range(6):
        square += error[row] * error[row]
    for joint in range(dim):
        pull = 0.0
        for row in range(6):
            pull += jacobian[row, joint] * error[row]
        if not periodic[joint] and (
            (q[joint] <= lower[joint] and pull < 0.0) or (q[joint] >= upper[joint] and pull > 0.0)
        ):
            jacobian[:, joint] = 0.0
    damping = (_LEAST_DAMPING + 0.5 * square) * np.eye(6)
    lifted = np.linalg.solve(jacobian @ jacobian.T + damping, error)
    for joint in range(dim):
        moved = 0.0
        for row in range(6):
            moved += jacobian[row, joint] * lifted[row]
        q[joint] += moved
        if not periodic[joint]:
            q[joint] = min(max(q[joint], lower[joint]), upper[joint])
