"""Inverse kinematics of a serial arm's tool by damped least squares, within the joints' limits.

Source: Sugihara, Solvability-Unconcerned Inverse Kinematics by the Levenberg-Marquardt Method, IEEE
Transactions on Robotics 27 (2011): the damping is half the error's square and a little more. A joint at its
limit that is pushed outwards is left out of the step.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from cspace.worlds.spatial.planning.kernels import gap
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.kinematics import link_frames_into

_ANY, _ALONG, _FULL = 0, 1, 2
# What an angle of 1 rad weighs beside places, m.
_LEVER_M = 0.3
_LEAST_DAMPING = 1e-6
# Of what is meant to be a unit vector or a rotation.
_UNIT = 1e-6


@dataclass(frozen=True, slots=True)
class Solving:
    """How poses are solved for.

    Args:
        starts: uniform configurations that the search begins from.
        iterations: most steps from each of them.
        place_m: largest distance of the tool to its place.
        turn_rad: largest angle between the tool's rotation, or its z axis, and what is asked for.
        apart_rad: solutions are distinct that differ by more than this in some joint.

    Raises:
        ScenarioError: a count is below 1 or a tolerance is not above 0.
    """

    starts: int = 16
    iterations: int = 60
    place_m: float = 0.001
    turn_rad: float = 0.0174
    apart_rad: float = 0.1

    def __post_init__(self) -> None:
        tolerances = (self.place_m, self.turn_rad, self.apart_rad)
        if min(self.starts, self.iterations) < 1 or not all(0.0 < one < np.inf for one in tolerances):
            raise ScenarioError(
                "the solving of poses does not fit",
                expected="counts of 1 or more and tolerances above 0",
                got=str(self)[:300],
            )


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
) -> NDArray[np.float64]:
    """Configurations that bring the tool to a place, obstacles and self-collision left aside.

    Args:
        arm: whose tool.
        place_m: (3,) of the tool's origin, in the base frame.
        rng: draws the starts.
        approach: (3,) unit vector in the base frame along which the tool's z axis shall point, with any turn
            about it.
        rotation: (3, 3) of the tool in the base frame; with neither any rotation will do.
        solving: number of starts, and tolerances.

    Returns:
        (n, d) rad within the limits, circles in [-pi, pi); n is 0 where nothing was found.

    Raises:
        ScenarioError: the place is none, the approach is no unit vector, the rotation is none, or both of
            these are given.
    """
    place = np.array(place_m, dtype=np.float64)
    wanted, mode = _wanted(approach, rotation)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ScenarioError("the tool's place does not fit", expected="three numbers", got=str(place)[:200])
    space = arm.space
    chain = _Chain(
        np.stack([joint.origin.matrix() for joint in arm.joints]),
        np.asarray([joint.axis for joint in arm.joints]),
        arm.tool.matrix(),
        np.asarray(space.lower, dtype=np.float64),
        np.asarray(space.upper, dtype=np.float64),
        np.asarray(space.periodic, dtype=np.bool_),
    )
    tolerance = (solving.place_m, solving.turn_rad, solving.apart_rad)
    starts = space.sample_uniform(rng, solving.starts)
    found: NDArray[np.float64] = _solve_all(starts, place, wanted, mode, chain, solving.iterations, tolerance)
    return space.wrap(found)


def _wanted(approach: ArrayLike | None, rotation: ArrayLike | None) -> tuple[NDArray[np.float64], int]:
    """The rotation that is asked for, of which an approach is the last column, and how much of it counts."""
    if approach is not None and rotation is not None:
        raise ScenarioError("the tool's pose is told twice", expected="an approach or a rotation", got="both")
    wanted = np.eye(3)
    if approach is not None:
        along = np.asarray(approach, dtype=np.float64)
        if along.shape != (3,) or not abs(np.linalg.norm(along) - 1.0) <= _UNIT:
            raise ScenarioError("an approach that is none", expected="a unit vector", got=str(along)[:200])
        wanted[:, 2] = along
        return wanted, _ALONG
    if rotation is not None:
        wanted = np.array(rotation, dtype=np.float64)
        turns = wanted.shape == (3, 3) and bool(np.abs(wanted @ wanted.T - np.eye(3)).max() <= _UNIT)
        if not turns or np.linalg.det(wanted) < 0.0:
            raise ScenarioError(
                "the tool's rotation is none", expected="a rotation (3, 3)", got=str(wanted)[:200]
            )
        return wanted, _FULL
    return wanted, _ANY


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
def _errors(chain, frames, place, wanted, mode, jacobian, error):  # type: ignore[no-untyped-def]
    """Fill the error (6,) and its Jacobian (6, d), turns weighed; how far off the tool is, m and rad."""
    now, axes = _product(frames[-1], chain.tool), chain.axes
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
def _product(first, second):  # type: ignore[no-untyped-def]
    """Of two transforms (4, 4); numba's own product asks for scipy."""
    out = np.zeros((4, 4))
    for row in range(4):
        for column in range(4):
            for inner in range(4):
                out[row, column] += first[row, inner] * second[inner, column]
    return out


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
    lifted = _solved(jacobian, error, _LEAST_DAMPING + 0.5 * square)
    for joint in range(dim):
        moved = 0.0
        for row in range(6):
            moved += jacobian[row, joint] * lifted[row]
        q[joint] += moved
        if not periodic[joint]:
            q[joint] = min(max(q[joint], lower[joint]), upper[joint])


@njit(cache=True, nogil=True, error_model="numpy")
def _solved(jacobian, error, damping):  # type: ignore[no-untyped-def]
    """Solve (J J^T + damping) x = error by Cholesky's factors."""
    factor, x = np.empty((6, 6)), np.empty(6)
    for row in range(6):
        for column in range(row + 1):
            value = damping if row == column else 0.0
            for joint in range(jacobian.shape[1]):
                value += jacobian[row, joint] * jacobian[column, joint]
            for inner in range(column):
                value -= factor[row, inner] * factor[column, inner]
            factor[row, column] = np.sqrt(value) if row == column else value / factor[column, column]
    for row in range(6):
        value = error[row]
        for inner in range(row):
            value -= factor[row, inner] * x[inner]
        x[row] = value / factor[row, row]
    for row in range(5, -1, -1):
        value = x[row]
        for inner in range(row + 1, 6):
            value -= factor[inner, row] * x[inner]
        x[row] = value / factor[row, row]
    return x
