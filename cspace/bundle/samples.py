"""What goes through a bundle: a picture for many requests, a request that fits, and the samples of one."""

import json
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.bundle.spec import BundleSpec
from cspace.errors import InputError, OtherRobotError
from cspace.plan import planning_space
from cspace.query import PlanQuery, SampleQuery
from cspace.space import LIMIT_TOLERANCE_RAD, NEAR_LIMIT_RAD, JointSpace
from cspace.world import Known, Sensor
from cspace.worlds import robot_digest, tool_constraints


@dataclass(frozen=True, slots=True)
class Encoding:
    """The encoder's view of one picture; ``mu`` is float32 (L,), ``sigma`` is float32 (L,), not negative."""

    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture that a bundle has encoded, by :meth:`Bundle.prepare`; what it costs is paid once."""

    digest: str
    image: NDArray[np.uint8]  # uint8, decoded
    sensor: Sensor
    encoding: Encoding
    novelty: float | None = None  # 0 to 1, how unlike the training scenarios it is, where a bundle tells
    map: NDArray[np.float32] | None = None  # what the bundle's map graph makes of it, where it has one
    known: Known | None = None
    pictures: int = 1
    # How likely each voxel holds something, float16 (X, Y, Z), computed once; None where no graph tells
    occupancy: Callable[[], NDArray[np.float16]] | None = None

    @cached_property
    def pixels(self) -> NDArray[np.float32]:
        """float32 (1, C, ...), as the graphs take it: four times the image's bytes, made at the first use."""
        return self.sensor.to_network(self.image[None])

    @property
    def size_bytes(self) -> int:
        """Of what it holds, nearly, before the first use of its pixels."""
        known = 0 if self.known is None else self.known.size_bytes
        held = 0 if self.occupancy is None else self.image.nbytes
        return self.image.nbytes + held + (0 if self.map is None else self.map.nbytes) + known


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What a model takes a scene to be, seen or not, on a grid of cells in the base frame."""

    low_m: tuple[float, float, float]
    cell_m: float
    # (X, Y, Z), the probability that a ball of the cell's width in its middle touches something
    occupied: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ProposalCounts:
    """How many configurations were proposed, and how many of them are in the answer, by their kind."""

    generator: int = 0
    generator_kept: int = 0
    uniform: int = 0
    uniform_kept: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """What a sampler gives."""

    samples: NDArray[np.float32]  # (n', d) rad
    # (n', k), the validity head's confidence, then the unseen share where it gives that; no columns
    # where the head was not asked
    scores: NDArray[np.float32]
    acceptance: float = 1.0
    ways: NDArray[np.int64] | None = None  # (n',), see :class:`SampleSet`
    proposals: ProposalCounts | None = None

    def only(self, kept: NDArray[np.bool_]) -> "Sampled":
        """The samples of which ``kept`` (n',) is true."""
        ways = None if self.ways is None else self.ways[kept]
        return Sampled(self.samples[kept], self.scores[kept], self.acceptance, ways, self.proposals)


@dataclass(frozen=True, slots=True)
class SampleSet:
    """Configurations for one picture."""

    samples: NDArray[np.float32]  # (n', d) rad, circles in [-pi, pi), others within their limits
    confidence: NDArray[np.float32] | None  # (n',), None without a validity head
    shortfall: int
    acceptance: float  # share of what was drawn that reached the confidence asked for; 1 where none was
    encode_ms: float  # time in the encoder; 0 for a picture that was prepared
    generate_ms: float
    unseen: NDArray[np.float32] | None = None  # (n',), share of the robot that no picture shows
    ways: NDArray[np.int64] | None = None  # (n',), the path that each sample lies along, 0 for the best
    proposals: ProposalCounts | None = None  # by kind; None for samples along paths


class FittedQuery(SampleQuery):
    """A query that :func:`fitted` has checked; the bundle that it fits takes it as it is."""

    __slots__ = ()


def fitted(query: SampleQuery, spec: BundleSpec, *, has_validity: bool) -> FittedQuery:
    """The query as its bundle takes it: start and goal wrapped, the confidence that holds."""
    if isinstance(query, FittedQuery):
        return query
    require_robot(query.robot, spec)
    least = query.min_confidence
    if least is None:
        least = (spec.confidence_threshold or 0.0) if has_validity else 0.0
    elif least > 0.0 and not has_validity:
        raise InputError(
            "the model has no validity head",
            expected="min_confidence 0",
            got=str(least),
            remedy="leave min_confidence out, or choose a model with a validity head",
        )
    start, goal = _endpoint(spec, "start", query.start), _endpoint(spec, "goal", query.goal)
    values = {item.name: getattr(query, item.name) for item in fields(query)}
    return FittedQuery(**(values | {"start": start, "goal": goal, "min_confidence": least}))


def require_robot(robot: str | None, spec: BundleSpec) -> None:
    """Refuse a robot that the model is not of; None is any."""
    if robot is not None and robot != (found := robot_digest(spec.world)):
        raise OtherRobotError(
            "the model is of another robot",
            expected=f"robot {robot}",
            got=f"{found}, {json.dumps(spec.world.body.to_dict())}"[:400],
            remedy="name a model of this robot; GET /models tells each model's",
        )


def _endpoint(spec: BundleSpec, name: str, angles: tuple[float, ...] | None) -> tuple[float, ...] | None:
    if name not in spec.endpoints:
        if angles is None:
            return None
        raise InputError(f"the model takes no {name}", expected="a path model", got=f"a {spec.kind} model")
    if angles is None:
        raise InputError(f"the model needs a {name}", expected=f"{spec.dim} angles in rad", got="none")
    return fitted_end(spec, name, angles)


def fitted_plan(spec: BundleSpec, query: PlanQuery) -> PlanQuery:
    """The query with the confidence that fits the bundle, where it names none."""
    if query.min_confidence is not None:
        return query
    return replace(query, min_confidence=spec.plan_confidence)


def fitted_end(
    spec: BundleSpec, name: str, angles: tuple[float, ...], space: JointSpace | None = None
) -> tuple[float, ...]:
    """A start or goal, finite rad, as a bundle takes it: circles wrapped, in single precision.

    A start that lies a little beyond a limit is taken as that limit.
    """
    if len(angles) != spec.dim:
        expected = f"{spec.dim} finite angles in rad"
        raise InputError(f"{name} does not fit the robot", expected=expected, got=str(list(angles))[:200])
    whose = "the robot's joints" if space is None else "this request"
    space = spec.world.space if space is None else space
    beyond_rad = NEAR_LIMIT_RAD if name == "start" else LIMIT_TOLERANCE_RAD
    what = f"{name} lies outside the limits of {whose}"
    configuration = space.admitted(angles, what, beyond_rad=beyond_rad)
    return tuple(space.to_float32(configuration).tolist())


def fitted_problem(spec: BundleSpec, query: PlanQuery) -> NDArray[np.float64]:
    """Start and goal of a query as a search takes them, (2, d) rad; (1, d) where a pose is the goal."""
    if (query.goal is None) == (query.goal_pose is None):
        raise InputError(
            "there is not one goal",
            expected="either goal, a configuration, or goal_pose, a pose of the tool",
            got="neither" if query.goal is None else "both",
        )
    space = None if query.limits is None else planning_space(spec.world, query.limits)
    tool_constraints(spec.world, query.goal_pose, query.upright)
    given = (("start", query.start), ("goal", query.goal))
    rows = [fitted_end(spec, name, end, space) for name, end in given if end is not None]
    return np.asarray(rows, dtype=np.float64)


def fitted_configurations(values: ArrayLike, spec: BundleSpec) -> NDArray[np.float32]:
    """Configurations as a bundle scores them, (n, d) rad: circles wrapped, in single precision."""
    rows, space = np.asarray(values), spec.world.space
    if rows.ndim != 2 or not len(rows) or rows.shape[1] != spec.dim or rows.dtype.kind not in "fiu":
        raise InputError(
            "the configurations do not fit the robot",
            expected=f"an array of shape (n, {spec.dim}) in rad, n at least 1",
            got=f"{rows.dtype} of shape {rows.shape}",
        )
    return space.to_float32(
        space.admitted(rows, "configurations lie outside the limits of the robot's joints")
    )
