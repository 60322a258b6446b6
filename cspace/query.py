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
from cspace.world import Contact, NextView

MAX_SEED = 2**64 - 1
MAX_EPSILON = 10.0
MAX_SAMPLES = 20_000
"""Of one request to a server, or to what stands in for one."""

DIGEST_PATTERN = "[0-9a-f]{64}"
"""Of a robot's name."""

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
    """A request for samples that is valid in itself; equal ones with equal pictures have equal answers.

    Args:
        n: how many, at least 1.
        seed: unsigned 64 bit.
        epsilon_sigma: the latent's standard deviation is raised by each value, 0 to 10; equal shares of the
            samples in this order, the remainder to the first.
        start: (d,) rad, for path models and only for them.
        goal: as ``start``.
        min_confidence: what the validity head has to score, 0 to 1; None for the bundle's own threshold
            (0 for a bundle without), 0 for all samples as they come.
        robot: whose configurations are wanted, as :func:`cspace.worlds.robot_digest` names it; a model of
            another robot refuses. None takes those of any.
    """

    n: int
    seed: int
    epsilon_sigma: tuple[float, ...] = PLAIN
    start: tuple[float, ...] | None = None
    goal: tuple[float, ...] | None = None
    min_confidence: float | None = None
    robot: str | None = None

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
        """The query of unchecked values.

        Raises:
            InputError: one is of another type or out of its range.
        """
        _whole("n", n, 1, None)
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
    return isinstance(value, str) and re.fullmatch(DIGEST_PATTERN, value, re.ASCII) is not None


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


def _whole(name: str, value: object, low: int, high: int | None) -> None:
    fits = isinstance(value, Integral) and not isinstance(value, bool)
    if not fits or value < low or (high is not None and value > high):  # type: ignore[operator]
        expected = f"a whole number, at least {low}" + ("" if high is None else f" and at most {high}")
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
    """A planning problem for a scene that a picture shows.

    Args:
        start: (d,) rad.
        goal: (d,) rad; None where ``goal_pose`` says where the path ends.
        seed: of all draws, unsigned 64 bit.
        min_confidence: below which no path is returned, 0 to 1; None for what fits the bundle, see
            :attr:`cspace.bundle.BundleSpec.plan_confidence`.
        time_limit_s: for the search, above 0.
        ways: number of paths to look for, 1 or more.
        next_view: whether the camera is wanted that would see most of what makes the path uncertain.
        views: cameras to choose it from, as plain values; none for some about the uncertain places.
        alternatives: whether all paths of sufficient confidence are wanted, for those who can check them.
        seen_by: cameras that the picture is from, where they are known: the next view is one from elsewhere.
        seen_state: where the robot was then, as a view file has it; needed for cameras on a link.
        explain: whether it is wanted what is in the way where no path is returned.
        goal_pose: of the tool in the robot's base, as plain values: ``pose``, as that of a camera, and where
            they are not the usual ones ``tolerance_m``, ``tolerance_rad`` and ``free_z_rotation``.
        limits: for each joint low and high, rad, which the path keeps to, or None for the joint's own.
        upright: ``axis`` of the tool that all states keep within ``max_rad`` of ``up`` in the base frame, as
            plain values.
        unwrapped: whether circles go on beyond [-pi, pi) along the path, from the start as it is given.
        goal_free: whether the robot is known to be free at the goal, as it is at its start.
    """

    start: tuple[float, ...]
    goal: tuple[float, ...] | None
    seed: int = 0
    min_confidence: float | None = None
    time_limit_s: float = 1.0
    ways: int = DEFAULT_PATHS
    next_view: bool = False
    views: tuple[Mapping[str, Any], ...] = ()
    alternatives: bool = False
    seen_by: tuple[Mapping[str, Any], ...] = ()
    seen_state: object = None
    explain: bool = False
    goal_pose: Mapping[str, Any] | None = None
    limits: tuple[tuple[float, float] | None, ...] | None = None
    upright: Mapping[str, Any] | None = None
    unwrapped: bool = False
    goal_free: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LeastConfidence:
    """Where the confidence of a path is lowest.

    Args:
        configuration: (d,) rad.
        confidence: of it alone.
        unseen: share of the robot that no picture shows there; None in worlds that are seen whole.
        along: how far along the path it lies, 0 to 1.
    """

    configuration: NDArray[np.float64]
    confidence: float
    unseen: float | None
    along: float


@dataclass(frozen=True, slots=True, eq=False)
class AlternativePath:
    """A path and a model's confidence in it.

    Args:
        path: (k, d) rad from start to goal.
        confidence: that the whole path touches nothing.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
    """

    path: NDArray[np.float64]
    confidence: float
    edges: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """An answer.

    Args:
        status: ``solved``; ``refused`` where no path is confident enough or none was found; ``timeout`` where
            none was found in time.
        path: (k, d) rad from start to goal, (0, d) unless it is solved.
        confidence: that the whole path touches nothing; of the best one where it is refused, 0 without one.
        edges: (k - 1,) the least confidence of a state on each of its pieces.
        unseen: (k - 1,) the largest share of the robot on each piece that no picture shows; None in worlds
            that are seen whole.
        cost: that its confidence is of, see :mod:`cspace.planning.cost`; 0 without a path.
        length_rad: Euclidean.
        found: paths that the best was chosen from.
        least: where the confidence of the best path is lowest; None without one.
        next_view: the camera that would see most of what makes that path uncertain; None where none was asked
            for, or none would see more.
        alternatives: all paths of sufficient confidence, the best first, which is the plan's; none where they
            were not asked for.
        search_ms: looking for paths.
        score_ms: asking the model about them.
        contact: what is in the way where there is no path; None where nothing is, or nobody asked.
        reason: why nothing was looked for, in words; None where something was.
    """

    status: Status
    path: NDArray[np.float64]
    confidence: float = 0.0
    edges: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, dtype=np.float32))
    unseen: NDArray[np.float32] | None = None
    cost: float = 0.0
    length_rad: float = 0.0
    found: int = 0
    least: LeastConfidence | None = None
    next_view: NextView | None = None
    alternatives: tuple[AlternativePath, ...] = ()
    search_ms: float = 0.0
    score_ms: float = 0.0
    contact: Contact | None = None
    reason: str | None = None
