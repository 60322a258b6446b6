"""What is asked of a sampler and of a planner, and what a planner answers. NumPy alone."""

import math
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import InputError
from cspace.world import Contact

MAX_SEED = 2**64 - 1
MAX_EPSILON = 10.0
MAX_SAMPLES = 20_000
"""Of one request to a server, or to what stands in for one."""

PLAIN = (0.0,)
"""The schedule that leaves the encoder's standard deviation as it is."""


class QueryOptions(TypedDict, total=False):
    """What a call that asks for samples may leave out, as :meth:`SampleQuery.checked` takes it."""

    epsilon_sigma: Sequence[float]
    start: ArrayLike | None
    goal: ArrayLike | None
    min_confidence: float | None
    robot: str | None


@dataclass(frozen=True, slots=True)
class SampleQuery:
    """A request for samples that is valid in itself; equal ones with equal pictures have equal answers."""

    n: int
    seed: int  # unsigned 64 bit
    # The latent's standard deviation is raised by each value, 0 to 10; equal shares of the samples in this
    # order, the remainder to the first
    epsilon_sigma: tuple[float, ...] = PLAIN
    start: tuple[float, ...] | None = None  # (d,) rad, for path models and only for them
    goal: tuple[float, ...] | None = None
    # What the validity head has to score; None for the bundle's own threshold, 0 for all samples
    min_confidence: float | None = None
    robot: str | None = None  # digest of the robot that the model has to be of; None for any

    @classmethod
    def checked(
        cls,
        n: int,
        seed: int,
        epsilon_sigma: Sequence[float] = PLAIN,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        min_confidence: float | None = None,
        robot: str | None = None,
    ) -> "SampleQuery":
        """The query of unchecked values."""
        _whole("n", n, 1, math.inf)
        _whole("seed", seed, 0, MAX_SEED)
        values = tuple(epsilon_sigma)
        if not values:
            raise InputError("epsilon_sigma is empty", expected="one value or more", got="none")
        for value in values:
            _within("epsilon_sigma", value, MAX_EPSILON)
        if min_confidence is not None:
            _within("min_confidence", min_confidence, 1.0)
            min_confidence = float(min_confidence)
        if robot is not None and not is_digest(robot):
            raise InputError("robot is no digest", expected="64 hexadecimal digits", got=repr(robot)[:200])
        ends = _configuration("start", start), _configuration("goal", goal)
        schedule = tuple(float(value) for value in values)
        return cls(int(n), int(seed), schedule, *ends, min_confidence, robot)


def is_digest(value: object) -> bool:
    """Whether a value is a SHA-256 in hexadecimal, in small letters."""
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None


def random_seed(seed: int | None = None) -> int:
    """The seed, or one that is drawn here, so that a request that is sent again is the same request."""
    return secrets.randbits(64) if seed is None else seed


def _configuration(name: str, value: ArrayLike | None) -> tuple[float, ...] | None:
    if value is None:
        return None
    try:
        angles = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        angles = np.array(math.nan)
    if angles.ndim != 1 or not np.all(np.isfinite(angles)):
        raise InputError(
            f"{name} is no configuration", expected="an array of finite angles in rad", got=str(value)[:200]
        )
    return tuple(angles.tolist())


def _whole(name: str, value: object, low: int, high: float) -> None:
    fits = isinstance(value, Integral) and not isinstance(value, bool)
    if not fits or not low <= value <= high:  # type: ignore[operator]
        expected = f"a whole number from {low} to {high}"
        raise InputError(f"{name} is out of range", expected=expected, got=repr(value)[:200])


def _within(name: str, value: object, high: float) -> None:
    fits = isinstance(value, Real) and not isinstance(value, bool | np.bool_)
    if not fits or not math.isfinite(value) or not 0.0 <= value <= high:  # type: ignore[arg-type, operator]
        raise InputError(
            f"{name} is out of range", expected=f"a finite number from 0 to {high:g}", got=repr(value)[:200]
        )


Status = Literal["solved", "refused", "timeout"]
DEFAULT_PATHS = 4


@dataclass(frozen=True, slots=True)
class PlanQuery:
    """A planning problem for a scene that a picture shows."""

    start: tuple[float, ...]  # (d,) rad
    goal: tuple[float, ...] | None  # (d,) rad; None where ``goal_pose`` says where the path ends
    seed: int = 0  # unsigned 64 bit
    min_confidence: float | None = None  # below which no path is returned; None for the bundle's own
    time_limit_s: float = 1.0  # for the search
    ways: int = DEFAULT_PATHS  # number of paths to look for
    alternatives: bool = False  # whether all paths of sufficient confidence are wanted
    explain: bool = False  # whether it is wanted what is in the way where no path is returned
    # Pose of the tool in the base frame: ``pose``, and perhaps ``tolerance_m``, ``tolerance_rad`` and
    # ``free_z_rotation``
    goal_pose: Mapping[str, Any] | None = None
    # For each joint low and high, rad, which the path keeps to, or None for the joint's own
    limits: tuple[tuple[float, float] | None, ...] | None = None
    # ``axis`` of the tool that all states keep within ``max_rad`` of ``up`` in the base frame
    upright: Mapping[str, Any] | None = None
    unwrapped: bool = False  # whether circles go on beyond [-pi, pi) along the path
    goal_free: bool = False  # whether the robot is known to be free at the goal, as it is at its start
    # (d,) of a trajectory, in place of the robot's own
    max_velocity_rad_s: tuple[float, ...] | None = None
    max_acceleration_rad_s2: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LeastConfidence:
    """Where the confidence of a path is lowest."""

    configuration: NDArray[np.float64]  # (d,) rad
    confidence: float  # of it alone
    unseen: float | None  # share of the robot in unknown space; None in worlds that are seen whole
    along: float  # how far along the path it lies, 0 to 1


@dataclass(frozen=True, slots=True, eq=False)
class AlternativePath:
    """A path and a model's confidence in it."""

    path: NDArray[np.float64]  # (k, d) rad from start to goal
    confidence: float  # that the whole path touches nothing
    edges: NDArray[np.float32]  # (k - 1,) the least confidence of a state on each edge


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Points in time, between which the acceleration is constant; circles go on beyond [-pi, pi)."""

    times_s: NDArray[np.float64]  # (n,) from 0
    positions: NDArray[np.float64]  # (n, d) rad
    velocities: NDArray[np.float64]  # (n, d) rad/s, 0 at both ends


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A planner's answer."""

    # `refused` where no path is confident enough or none was found, `timeout` where none was found in time
    status: Status
    path: NDArray[np.float64]  # (k, d) rad from start to goal, (0, d) unless it is solved
    confidence: float = 0.0  # that the whole path touches nothing; of the best one where it is refused
    edges: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, dtype=np.float32))  # (k - 1,)
    # (k - 1,) the largest share of the robot in unknown space on each edge; None in worlds seen whole
    unseen: NDArray[np.float32] | None = None
    cost: float = 0.0  # see :mod:`cspace.planning.cost`
    length_rad: float = 0.0  # Euclidean
    found: int = 0  # paths that the best was chosen from
    least: LeastConfidence | None = None
    alternatives: tuple[AlternativePath, ...] = ()  # the best first
    search_ms: float = 0.0
    score_ms: float = 0.0
    contact: Contact | None = None  # what is in the way where there is no path
    reason: str | None = None  # why nothing was looked for, in words
    trajectory: Trajectory | None = None  # of the path, where limits of velocity and acceleration are known
