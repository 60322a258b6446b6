"""What goes through a bundle: a picture for many requests, a request that fits, and the samples of one."""

import json
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
    """A picture that a bundle has encoded; what it costs is paid once. Make one with :meth:`Bundle.prepare`.

    Args:
        image: uint8, decoded.
        novelty: how unlike the training scenarios it is, 0 to 1; None for a bundle that does not tell.
        map: float32, what the bundle's map graph makes of it; None for a bundle without.
    """

    digest: str
    image: NDArray[np.uint8]
    sensor: Sensor
    encoding: Encoding
    novelty: float | None = None
    map: NDArray[np.float32] | None = None
    known: Known | None = None
    pictures: int = 1

    @cached_property
    def pixels(self) -> NDArray[np.float32]:
        """float32 (1, C, ...), as the graphs take it: four times the image's bytes, made at the first use."""
        return self.sensor.to_network(self.image[None])

    @property
    def size_bytes(self) -> int:
        """Of what it holds, nearly, before the first use of its pixels."""
        known = 0 if self.known is None else self.known.size_bytes
        return self.image.nbytes + (0 if self.map is None else self.map.nbytes) + known


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What a model takes a scene to be, seen or not, on a grid of cells in the base frame.

    Args:
        occupied: float32 (X, Y, Z), the probability that a ball of the cell's width in its middle touches
            something.
    """

    low_m: tuple[float, float, float]
    cell_m: float
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
    """What a sampler gives.

    Args:
        samples: float32 (n', d) rad.
        scores: float32 (n', k), the validity head's confidence, then the unseen share where it gives that;
            no columns where the head was not asked.
        ways: int64 (n',), see :class:`SampleSet`.
    """

    samples: NDArray[np.float32]
    scores: NDArray[np.float32]
    acceptance: float = 1.0
    ways: NDArray[np.int64] | None = None
    proposals: ProposalCounts | None = None

    def only(self, kept: NDArray[np.bool_]) -> "Sampled":
        """The samples of which ``kept`` (n',) is true."""
        ways = None if self.ways is None else self.ways[kept]
        return Sampled(self.samples[kept], self.scores[kept], self.acceptance, ways, self.proposals)


@dataclass(frozen=True, slots=True)
class SampleSet:
    """Configurations for one picture.

    Args:
        samples: float32 (n', d) rad, circles in [-pi, pi), others within their limits, as real numbers.
        confidence: float32 (n',), None without a validity head.
        acceptance: share of what was drawn that reached the confidence asked for; 1 where none was.
        encode_ms: time in the encoder; 0 for a picture that was prepared.
        unseen: float32 (n',), share of the robot where no picture shows what is there; None where that is not
            told.
        ways: int64 (n',), the path that each sample lies along, 0 for the one with the lowest cost; None for
            samples that do not lie along paths.
        proposals: by kind; None for samples along paths.
    """

    samples: NDArray[np.float32]
    confidence: NDArray[np.float32] | None
    shortfall: int
    acceptance: float
    encode_ms: float
    generate_ms: float
    unseen: NDArray[np.float32] | None = None
    ways: NDArray[np.int64] | None = None
    proposals: ProposalCounts | None = None


class FittedQuery(SampleQuery):
    """A query that :func:`fitted` has checked; the bundle that it fits takes it as it is."""

    __slots__ = ()


def fitted(query: SampleQuery, spec: BundleSpec, *, has_validity: bool) -> FittedQuery:
    """The query as its bundle takes it: start and goal wrapped, the confidence that holds.

    Whoever prepares a picture for it fits it before that, so that nothing is computed for one that does not.

    Args:
        has_validity: whether the bundle scores its samples.
    """
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
        raise InputError(
            f"the model takes no {name}",
            expected=f"no {name} for a {spec.kind} model",
            got=str(list(angles))[:200],
            remedy=f"leave {name} out, or choose a path model",
        )
    if angles is None:
        raise InputError(
            f"the model needs a {name}",
            expected=f"{spec.dim} angles in rad",
            got="none",
            remedy=f"send {name}",
        )
    return fitted_end(spec, name, angles)


def fitted_plan(spec: BundleSpec, query: PlanQuery) -> PlanQuery:
    """The query with the confidence that fits the bundle, where it names none."""
    if query.min_confidence is not None:
        return query
    return replace(query, min_confidence=spec.plan_confidence)


def fitted_end(
    spec: BundleSpec, name: str, angles: tuple[float, ...], space: JointSpace | None = None
) -> tuple[float, ...]:
    """A start or goal as a bundle takes it: circles wrapped, in single precision.

    A start that lies a little beyond a limit is taken as that limit.

    Args:
        angles: finite, rad.
        space: with narrower limits than the robot's; None for these.
    """
    if len(angles) != spec.dim:
        raise InputError(
            f"{name} does not fit the robot",
            expected=f"{spec.dim} finite angles in rad",
            got=str(list(angles))[:200],
        )
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
    """Configurations as a bundle scores them, (n, d) rad: circles wrapped, in single precision.

    Args:
        values: (n, d) finite rad, at least one row.
    """
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
