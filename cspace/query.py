"""What is asked of a sampler and of a planner, and what a planner answers. NumPy alone."""

import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import InputError
from cspace.files import Share, read_object
from cspace.world import Contact

MAX_SEED = 2**64 - 1
MAX_EPSILON = 10.0
MAX_SAMPLES = 20_000
"""Of one request to a server, or to what stands in for one."""
DOUBTED = 0.1
"""How likely a voxel of unseen space holds something that a careful path keeps away from."""

_DIGEST = "^[0-9a-f]{64}$"
PLAIN = (0.0,)
"""The schedule that leaves the encoder's standard deviation as it is."""


_Angles = tuple[Annotated[float, Field(allow_inf_nan=False)], ...]


@dataclass(frozen=True, slots=True)
class SampleQuery:
    """A request for samples that is valid in itself; equal ones with equal pictures have equal answers."""

    n: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)]
    # The latent's standard deviation is raised by each value; equal shares of the samples in this order, the
    # remainder to the first
    epsilon_sigma: Annotated[
        tuple[Annotated[float, Field(ge=0.0, le=MAX_EPSILON)], ...], Field(min_length=1)
    ] = PLAIN
    start: _Angles | None = None  # (d,) rad, for path models and only for them
    goal: _Angles | None = None
    # What the validity head has to score; None for the bundle's own threshold, 0 for all samples
    min_confidence: Share | None = None
    # Digest of the robot that the model has to be of; None for any
    robot: Annotated[str, Field(pattern=_DIGEST)] | None = None

    @classmethod
    def checked(cls, n: int, seed: int, **options: Any) -> "SampleQuery":
        """The query of unchecked values, also numpy's, of the fields that ``options`` name."""
        given = {"n": n, "seed": seed, **options}
        values = {
            name: None if one is None else np.asarray(one).tolist()
            for name, one in given.items()
            if one is not None or name == "seed"
        }
        return read_object(cls, values, "the query", InputError)


def is_digest(value: object) -> bool:
    """Whether a value is a SHA-256 in hexadecimal, in small letters."""
    return isinstance(value, str) and re.fullmatch(_DIGEST, value) is not None


def random_seed(seed: int | None = None) -> int:
    """The seed, or one that is drawn here, so that a request that is sent again is the same request."""
    return secrets.randbits(64) if seed is None else seed


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
