"""A bundle's description, as ``bundle.json`` holds it, and how requests fit it."""

import json
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveInt

from cspace.bundle.files import SPEC_FILE
from cspace.errors import BundleIntegrityError, InputError, OtherRobotError
from cspace.files import Share, adapter_of, json_text, read_json, read_object, validated
from cspace.plan import planning_space
from cspace.query import PlanQuery, SampleQuery
from cspace.space import LIMIT_TOLERANCE_RAD, NEAR_LIMIT_RAD, JointSpace
from cspace.view_file import MAX_PICTURES
from cspace.worlds import WorldField, robot_digest, tool_constraints

SCHEMA_VERSION = 6
ModelKind = Literal["generator", "mixture", "ways"]
WAYS: Literal["ways"] = "ways"
ENDPOINTS = ("start", "goal")
PICTURE, MAP, OCCUPANCY = "image", "map", "occupancy"
# Default minimum confidence of calibrated plans; at it 97 % of the validation problems stay solved.
PLAN_CONFIDENCE = 0.2
_RESERVED = frozenset({"latent", PICTURE, MAP, *ENDPOINTS})
_Calibration = tuple[float, Annotated[float, Field(gt=0.0)]]
_Quantiles = Annotated[tuple[Annotated[tuple[float, ...], Field(min_length=2)], ...], Field(min_length=1)]


@validated(BundleIntegrityError)
class RandomInput:
    """One random input of the generator graph, drawn for every latent."""

    name: Annotated[str, Field(min_length=1)]
    distribution: Literal["uniform", "normal"]  # in [low, high), or of mean 0 and variance 1
    shape: tuple[PositiveInt, ...]
    low: float | None = None  # lower end of a uniform input, None for a normal one
    high: float | None = None  # upper end of a uniform input, None for a normal one

    def __post_init__(self) -> None:
        if self.name in _RESERVED:
            raise ValueError(f"a name of its own, not {self.name}")
        if self.distribution == "normal":
            fits = self.low is None and self.high is None
        else:
            fits = self.low is not None and self.high is not None and self.low < self.high
        if not fits:
            raise ValueError("low < high where uniform and none else")


@validated(BundleIntegrityError)
class Standardisation:
    """An affine map to zero mean and unit variance, per joint."""

    mean: tuple[float, ...]  # (d,) rad
    std: tuple[Annotated[float, Field(gt=0.0)], ...]  # (d,) rad


@validated(BundleIntegrityError)
class Provenance:
    """How a bundle was made; plain JSON values throughout."""

    git_commit: str | None = None
    git_dirty: bool | None = None  # whether the tree held changes beside that commit
    data_digest: str | None = None  # SHA-256 digest of the data set
    seeds: Mapping[str, Any] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    created: str | None = None  # ISO 8601 time in UTC
    command: str | None = None


@validated(BundleIntegrityError)
class BundleSpec:
    """The contract between a bundle's graphs and whoever samples from them."""

    world: WorldField  # its pixels are the encoder's input size
    latent_dim: PositiveInt
    # `configuration` (free configurations) or `path` (conditioned on start and goal)
    kind: Literal["configuration", "path"] = "configuration"
    # `generator` or `mixture`, both one graph with the same inputs and outputs; or `ways`, a path sampler
    # that searches and has no such graph
    model_kind: ModelKind = "generator"
    looks_at_picture: bool = False  # whether the generator takes the picture itself beside its latent
    looks_at_map: bool = False  # whether it takes what the map graph makes of the picture
    samples_per_latent: PositiveInt = 1
    random_inputs: tuple[RandomInput, ...] = ()  # beside the latent, in the order of the draws
    standardisation: Standardisation | None = None  # of the angles inside the graph, for information
    confidence_threshold: Share | None = None  # that training recommends for the validity head
    novelty_quantiles: _Quantiles | None = None  # rising, over known pictures, for each score
    # (a, b) for one picture, for two and so on, the last for more: a path of cost D is free with exp(-exp(a +
    # b log D)), b above 0; see :mod:`cspace.planning`. None for (0, 1).
    plan_calibration: (
        Annotated[tuple[_Calibration, ...], Field(min_length=1, max_length=MAX_PICTURES)] | None
    ) = None
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        names = [item.name for item in self.random_inputs]
        scale, rows = self.standardisation, self.novelty_quantiles or ()
        widths = set() if scale is None else {len(scale.mean), len(scale.std)}
        wrong = {
            "random_inputs: different names": len(set(names)) != len(names),
            "novelty_quantiles: rising rows": any(np.any(np.diff(row) < 0.0) for row in rows),
            "standardisation: a number a joint": widths - {self.dim},
            f"kind: path for {WAYS}": self.model_kind == WAYS and self.kind != "path",
        }
        if any(wrong.values()):
            raise ValueError("; ".join(rule for rule, is_broken in wrong.items() if is_broken))

    @property
    def dim(self) -> int:
        return self.world.dim

    @property
    def conditions(self) -> tuple[str, ...]:
        """What the generator takes beside the latent: the picture, its map, start and goal, or nothing."""
        seen = {PICTURE: self.looks_at_picture, MAP: self.looks_at_map}
        return (*(name for name, taken in seen.items() if taken), *self.endpoints)

    @property
    def endpoints(self) -> tuple[str, ...]:
        return ENDPOINTS if self.kind == "path" else ()

    def calibration_for(self, pictures: int) -> tuple[float, float]:
        each = self.plan_calibration or ((0.0, 1.0),)
        return each[min(pictures, len(each)) - 1]

    @property
    def plan_confidence(self) -> float:
        """Default minimum confidence of a path: 0 where plans are not calibrated."""
        return 0.0 if self.plan_calibration is None else PLAN_CONFIDENCE

    @property
    def _derived(self) -> dict[str, Any]:
        """What ``bundle.json`` holds beside the fields, for it follows from them."""
        return {
            "joint_space": self.world.space.to_dict(),
            "image": self.world.sensor.convention,
            "conditions": list(self.conditions),
        }

    def to_json(self) -> bytes:
        values = adapter_of(BundleSpec).dump_python(self) | {"schema_version": SCHEMA_VERSION} | self._derived
        for name in _LOOKS:
            del values[name]
        return json_text(values).encode()

    @classmethod
    def from_json(cls, data: bytes) -> "BundleSpec":
        """Parse and validate ``bundle.json``; every key is required and no other is allowed."""
        members = read_json(data, SPEC_FILE, BundleIntegrityError)
        if (version := members.pop("schema_version", None)) != SCHEMA_VERSION:
            raise BundleIntegrityError(
                "the bundle's schema is another",
                expected=f"schema_version {SCHEMA_VERSION}",
                got=repr(version)[:200],
                remedy="use the release of cspace-sampler that wrote the bundle, or export it again",
            )
        derived = {name: members.pop(name, None) for name in _DERIVED}
        seen = derived["conditions"] if isinstance(derived["conditions"], list) else ()
        members = {name: condition in seen for name, condition in _LOOKS.items()} | members
        spec: BundleSpec = read_object(cls, members, SPEC_FILE, BundleIntegrityError)
        for name, value in derived.items():
            if value != spec._derived[name]:
                expected = json.dumps(spec._derived[name])
                raise BundleIntegrityError(
                    f"{SPEC_FILE}: {name} does not fit", expected=expected, got=repr(value)[:200]
                )
        return spec


# What follows from the other members.
_DERIVED = ("joint_space", "image", "conditions")
_LOOKS = {"looks_at_picture": PICTURE, "looks_at_map": MAP}


def fitted(query: SampleQuery, spec: BundleSpec, *, has_validity: bool) -> SampleQuery:
    """The query as its bundle takes it: start and goal wrapped, the confidence that holds."""
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
    return replace(query, start=start, goal=goal, min_confidence=least)


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
    least = spec.plan_confidence if query.min_confidence is None else query.min_confidence
    return replace(query, min_confidence=least)


def fitted_end(
    spec: BundleSpec, name: str, angles: tuple[float, ...], space: JointSpace | None = None
) -> tuple[float, ...]:
    """A start or goal as a bundle takes it: circles wrapped, a start near a limit at it, single precision."""
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
    for name in ("max_velocity_rad_s", "max_acceleration_rad_s2"):
        rates = getattr(query, name)
        if rates is not None and len(rates) != spec.dim:
            expected = f"{spec.dim} positive numbers"
            raise InputError(f"{name} does not fit the robot", expected=expected, got=str(list(rates))[:200])
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
