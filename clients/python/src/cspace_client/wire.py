"""What requests and answers of the HTTP API hold, as pydantic models: one definition for server and client.

Requests refuse unknown fields. Answers ignore them, so that a client reads those of a newer server.
"""

import base64
import binascii
import re
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PlainSerializer,
    PlainValidator,
    Tag,
    WithJsonSchema,
    model_validator,
)

MAX_SEED = 2**64 - 1
MAX_SAMPLES, MAX_EXPLAINED, MAX_OUTCOMES = 20_000, 1000, 1000
MAX_JOINTS, MAX_EPSILON, MAX_EPSILONS = 64, 10.0, 1000
MAX_PICTURES, MAX_PATHS, MAX_TIME_S = 4, 64, 10.0
MAX_BODIES, MAX_ATTACHED, MAX_IGNORED, MAX_PAIRS, MAX_MESHES = 500, 16, 64, 1000, 32

FORM_TEXTS = frozenset({"model", "robot", "seed"})
"""Fields of a form that are plain text. All others are JSON, or files: `image`, `mesh`, `configurations`."""
FORM_REPEATED = frozenset({"image", "camera", "epsilon_sigma", "view"})
"""Fields that a form may repeat."""

DIGEST, NAME = "[0-9a-f]{64}", "[A-Za-z0-9][A-Za-z0-9-]{0,62}"


def _listed(value: object) -> object:
    """Arrays and tuples as lists."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _one_or_more(value: object) -> object:
    value = _listed(value)
    return value if isinstance(value, list) else [value]


def _from_base64(value: object) -> object:
    if not isinstance(value, str):
        return value
    # As a canvas, MIME encoders and base64url write it, too.
    text = value.partition(",")[2] if value.startswith("data:") else value
    try:
        return base64.b64decode("".join(text.split()).replace("-", "+").replace("_", "/"), validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError("not base64") from error


def _parse_seed(value: object) -> object:
    return int(value) if isinstance(value, str) and re.fullmatch("[0-9]{1,20}", value, re.ASCII) else value


Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Seconds = Annotated[float, Field(ge=0.0, le=1e10)]
PartName = Annotated[str, Field(min_length=1, max_length=100)]
Pair = Annotated[list[PartName], Field(min_length=2, max_length=2), BeforeValidator(_listed)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3), BeforeValidator(_listed)]
Quaternion = Annotated[list[Number], Field(min_length=4, max_length=4), BeforeValidator(_listed)]
Matrix = Annotated[list[Quaternion], Field(min_length=4, max_length=4), BeforeValidator(_listed)]
Configuration = Annotated[list[Number], Field(max_length=MAX_JOINTS), BeforeValidator(_listed)]
Range = Annotated[list[Number], Field(min_length=2, max_length=2), BeforeValidator(_listed)]
Limits = Annotated[list[Range | None], Field(max_length=MAX_JOINTS), BeforeValidator(_listed)]
Rates = Annotated[list[Positive], Field(max_length=MAX_JOINTS), BeforeValidator(_listed)]
Epsilon = Annotated[float, Field(ge=0.0, le=MAX_EPSILON, allow_inf_nan=False)]
Schedule = Annotated[
    list[Epsilon], Field(min_length=1, max_length=MAX_EPSILONS), BeforeValidator(_one_or_more)
]
RobotReference = Annotated[str, Field(pattern=f"^({DIGEST}|{NAME})$")]
ModelVersion = Annotated[str, Field(pattern="^[A-Za-z0-9][A-Za-z0-9._-]{0,99}/[0-9]{1,9}$")]
Seed = Annotated[
    Annotated[int, Field(ge=0, le=MAX_SEED)] | None,
    BeforeValidator(_parse_seed),
    WithJsonSchema({"type": ["integer", "string", "null"], "minimum": 0, "pattern": "^[0-9]{1,20}$"}),
]
_SEED = Field(None, description="Unsigned 64 bit as number or decimal text; drawn and returned when absent.")


_MAX_MEMBERS = 100


class Request(BaseModel):
    """Base of requests and their parts."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, values: Any) -> Any:
        """NumPy's numbers and arrays as plain ones."""
        if not isinstance(values, dict):
            return values
        if len(values) > _MAX_MEMBERS:
            # Each unknown one would be an error of its own, a kilobyte.
            raise ValueError(f"an object of at most {_MAX_MEMBERS} members")
        return {
            name: one.tolist() if isinstance(one, np.ndarray | np.generic) else one
            for name, one in values.items()
        }


class Pose(Request):
    """A place in m and a rotation."""

    translation: Vector
    quaternion_xyzw: Quaternion = Field([0.0, 0.0, 0.0, 1.0], description="With a norm of 1.")


AnyPose = Annotated[
    Annotated[Pose, Tag("placed")] | Annotated[Matrix, Tag("matrix")],
    Discriminator(lambda value: "placed" if isinstance(value, dict | Pose) else "matrix"),
]


class Camera(Request):
    """A camera in the robot's base: pinhole numbers in pixels, or a ROS CameraInfo, and a pose."""

    fx: Number | None = None
    fy: Number | None = None
    cx: Number | None = None
    cy: Number | None = None
    camera_info: dict[str, Any] | str | None = Field(None, description="Or a ROS CameraInfo.")
    pose: AnyPose = Field(description="4 x 4, m, or `translation` and `quaternion_xyzw`.")
    frame: Literal["optical", "body"] = Field("optical", description="`body`: x forward, z up.")
    link: str | None = Field(None, description="In whose frame `pose` is; absent, the base.")
    stamp_s: Number | None = Field(None, description="Of the picture, seconds since the epoch.")

    @model_validator(mode="after")
    def _numbers_or_info(self) -> Self:
        numbers = [value is not None for value in (self.fx, self.fy, self.cx, self.cy)]
        if any(numbers) if self.camera_info is not None else not all(numbers):
            raise ValueError("a camera has fx, fy, cx, cy, or camera_info")
        return self


class View(Request):
    """A camera that could take another picture."""

    fx: Number
    fy: Number
    cx: Number
    cy: Number
    width: int
    height: int
    pose: Matrix


class Box(Request):
    """A cuboid."""

    size_m: Vector


class Cylinder(Request):
    """About its own z, centred."""

    radius_m: Positive
    length_m: Positive


class Sphere(Request):
    """A ball."""

    radius_m: Positive


class Mesh(Request):
    """A binary STL of `meshes`, in m times `scale`."""

    file: PartName
    scale: Positive = 1.0


class Disc(Request):
    """A disc of a plane."""

    x_m: Number
    y_m: Number
    radius_m: Positive


_SHAPES = ("box", "cylinder", "sphere", "mesh", "disc")


class Volume(Request):
    """A shape with a pose in the base frame."""

    name: Annotated[str, Field(max_length=100)] = ""
    box: Box | None = None
    cylinder: Cylinder | None = None
    sphere: Sphere | None = None
    mesh: Mesh | None = None
    pose: AnyPose | None = Field(None, description="As of a camera; absent, the frame itself.")

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if sum(getattr(self, name, None) is not None for name in _SHAPES) != 1:
            raise ValueError(f"a body has one of {', '.join(_SHAPES)}")
        return self


class Body(Volume):
    """A known body in the base frame; in a plane a name and a disc."""

    name: PartName
    disc: Disc | None = None


class AttachedBody(Volume):
    """A body that moves with the arm."""

    name: PartName
    link: PartName = Field("tool", description="The part of the robot whose frame `pose` is in.")
    touch_links: list[PartName] = Field([], max_length=100, description="Parts that it may touch.")


def _state_kind(state: object) -> str:
    rows = isinstance(state, list | tuple) and any(one is None or np.ndim(one) for one in state)
    return "each" if rows or getattr(state, "ndim", 1) == 2 else "one"


State = Annotated[
    Annotated[Configuration, Tag("one")]
    | Annotated[
        Annotated[list[Configuration | None], Field(max_length=16), BeforeValidator(_listed)], Tag("each")
    ],
    Discriminator(_state_kind),
]
Cameras = Annotated[list[Camera], Field(max_length=16), BeforeValidator(_one_or_more)]
Picture = Annotated[
    bytes, BeforeValidator(_from_base64), WithJsonSchema({"type": "string", "contentEncoding": "base64"})
]
Pictures = Annotated[list[Picture], Field(min_length=1, max_length=16), BeforeValidator(_one_or_more)]


class KnownFields(Request):
    """What is known of a scene beside its pictures."""

    scene: list[Body] = Field([], max_length=MAX_BODIES, description="Bodies in the base frame.")
    attached: list[AttachedBody] = Field([], max_length=MAX_ATTACHED, description="Held by the arm.")
    allowed: list[Pair] = Field([], max_length=MAX_PAIRS, description="Pairs of names that may touch.")
    ignore: list[Volume] = Field([], max_length=MAX_IGNORED, description="Volumes that count as free.")
    meshes: dict[PartName, str] = Field({}, max_length=MAX_MESHES, description="STL in base64.")


class ViewFields(KnownFields):
    """What goes with depth pictures and what is known."""

    camera: Cameras = Field([], description="One for each depth picture, in the same order.")
    state: State | None = Field(None, description="Where the robot was, rad; or one for each image.")
    max_age_s: Positive | None = Field(None, description="Refuses older pictures, by `stamp_s`.")
    depth_scale_m: Number | None = Field(
        None, ge=1e-6, le=1.0, description="Metres per unit of the pictures: 0.001 when absent, 1 for floats."
    )
    check_pose: bool = Field(
        default=True,
        description="Refuse a `state` or pose by which the arm is clearly not where the pictures show it.",
    )


class SampleQuery(Request):
    """What is asked of a sampler."""

    n: int = Field(300, ge=1, le=MAX_SAMPLES, description="How many samples.")
    seed: Seed = _SEED
    epsilon_sigma: Schedule = Field(
        [0.0], description="Added to the encoder's standard deviation; several values share the samples."
    )
    start: Configuration | None = Field(None, description="For path models and only for them, rad.")
    goal: Configuration | None = Field(None, description="As `start`.")
    min_confidence: Share | None = Field(None, description="Absent, the model's threshold; 0 returns all.")


class GoalPose(Request):
    """Where the tool's frame shall be in the end, in the robot's base."""

    pose: AnyPose
    tolerance_m: float = Field(0.005, ge=1e-4, le=1.0)
    tolerance_rad: float = Field(0.05, ge=1e-3, le=np.pi)
    free_z_rotation: bool = Field(default=False, description="Any turn about z will do.")


class Upright(Request):
    """An axis in the tool's frame that stays within `max_rad` of `up` in the base."""

    axis: Vector
    max_rad: float = Field(ge=1e-3, le=np.pi)
    up: Vector = [0.0, 0.0, 1.0]


class PlanQuery(Request):
    """What is asked of a planner."""

    start: Configuration = Field(description="Where the path begins, rad.")
    goal: Configuration | None = Field(None, description="Where it ends; either this or `goal_pose`.")
    goal_pose: GoalPose | None = Field(None, description="Of arms in space: where the tool ends.")
    limits: Limits | None = Field(None, description="For each joint `[low, high]`, or null for its own.")
    upright: Upright | None = Field(None, description="An axis that stays upright.")
    max_velocity_rad_s: Rates | None = Field(None, description="Of each joint; absent, the robot's.")
    max_acceleration_rad_s2: Rates | None = Field(None, description="As `max_velocity_rad_s`.")
    unwrapped: bool = Field(default=False, description="Circles go on beyond [-pi, pi).")
    goal_free: bool = Field(default=False, description="The robot is known to be free at the goal.")
    seed: Seed = _SEED
    min_confidence: Share | None = Field(None, description="Absent, 0.2 where plans are calibrated.")
    max_risk: Share | None = Field(None, description="In place of `min_confidence`: of a collision.")
    time_limit_s: Number = Field(1.0, ge=0.01, le=MAX_TIME_S, description="Of search and refinement.")
    ways: int = Field(4, ge=1, le=MAX_PATHS, description="Number of paths to search for.")
    alternatives: bool = Field(default=False, description="Return all paths of sufficient confidence.")
    explain: bool = Field(default=False, description="Say in `contact` what is in the way.")
    keep: bool = Field(default=False, description="Let the server keep the plan for training.")


class _Outcome(Request):
    request_id: str = Field(pattern="^[A-Za-z0-9._-]{1,128}$", description="`X-Request-ID` of the answer.")
    model: ModelVersion = Field(description="The model that answered, as `name/version`.")
    receipt: str | None = Field(None, max_length=1000, description="That the answer carried.")
    stamp_s: Seconds | None = Field(None, description="When this was known, since the epoch.")
    confidence: Share | None = Field(None, description="That the answer stated.")
    novelty: Share | None = Field(None, description="That the answer stated.")
    site: str | None = Field(None, pattern="^[A-Za-z0-9._-]{1,64}$", description="A name of the place.")


class PlanOutcome(_Outcome):
    """What became of an answer of `POST /plan`."""

    kind: Literal["plan"] = "plan"
    success: bool = Field(description="Whether the path was free, or was executed to its end.")
    executed: bool | None = Field(None, description="Whether a robot moved along the path.")
    collided: bool | None = Field(None, description="Whether the path collides.")
    collided_at: Share | None = Field(None, description="Where first, as a share of its length.")
    time_s: Seconds | None = Field(None, description="From the request to this outcome.")

    @model_validator(mode="after")
    def _only_of_collisions(self) -> Self:
        if self.collided_at is not None and not self.collided:
            raise ValueError("collided_at is of paths that collide")
        return self


class SamplesOutcome(_Outcome):
    """What exact checks found of an answer of `POST /sample`."""

    kind: Literal["samples"] = "samples"
    checked: int = Field(ge=0, le=MAX_SAMPLES, description="How many samples were checked.")
    free: int = Field(ge=0, le=MAX_SAMPLES, description="How many of those were free.")

    @model_validator(mode="after")
    def _of_those_checked(self) -> Self:
        if self.free > self.checked:
            raise ValueError("free is at most checked")
        return self


Outcome = Annotated[PlanOutcome | SamplesOutcome, Field(discriminator="kind")]


class OutcomesRequest(Request):
    """A batch of outcomes."""

    outcomes: list[Outcome] = Field(min_length=1, max_length=MAX_OUTCOMES)


def _array(dtype: type[np.generic], axes: int) -> tuple[object, ...]:
    """Annotations of an array: numbers in JSON, a NumPy array for who reads the answer.

    Whoever writes an answer may give an array or lists.
    """

    def read(value: object) -> NDArray[Any]:
        if isinstance(value, list) and not value:
            return np.empty((0,) * axes, dtype)
        return np.asarray(value, dtype)

    schema: dict[str, Any] = {"type": "number"}
    for _ in range(axes):
        schema = {"type": "array", "items": schema}
    return (
        PlainValidator(read),
        PlainSerializer(lambda value: value.tolist() if isinstance(value, np.ndarray) else value),
        WithJsonSchema(schema),
    )


Float32Rows = Annotated[NDArray[np.float32], *_array(np.float32, 2)]
Float32s = Annotated[NDArray[np.float32], *_array(np.float32, 1)]
Rows = Annotated[NDArray[np.float64], *_array(np.float64, 2)]
Numbers = Annotated[NDArray[np.float64], *_array(np.float64, 1)]
SeedText = Annotated[int, PlainSerializer(str), WithJsonSchema({"type": "string", "pattern": "^[0-9]+$"})]


def _absent(value: object) -> bool:
    return value is None


class Answer(BaseModel):
    """Base of answers and their parts."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class JointSpaceInfo(Answer):
    """The space that configurations live in; ranges only where a joint has limits."""

    kind: Literal["torus", "box", "mixed"] = Field(description="All circles, none, or some.")
    dim: int
    unit: Literal["rad"] = "rad"
    lower: list[float] | None = Field(None, exclude_if=_absent)
    upper: list[float] | None = Field(None, exclude_if=_absent)
    periodic: list[bool] | None = Field(None, exclude_if=_absent, description="Whether each is a circle.")


class ModelInfo(Answer):
    """The model that answered."""

    name: str
    version: int = Field(description="Number in the registry; 0 for a shipped model.")
    alias: str | None = Field(None, description="By which it was found.")
    run_id: str | None = None
    digest: str = Field(description="SHA-256 of the bundle's sums.")
    fallback: bool = Field(default=False, description="Whether a shipped model stands in for a champion.")
    robot: str | None = Field(None, description="SHA-256 of the robot in `GET /models`.")
    alias_confirmed: bool = Field(default=True, description="False if the alias may have moved.")


class ScenarioInfo(Answer):
    """What the model makes of the picture."""

    novelty: float | None = Field(None, description="Share of known pictures that are less unusual.")


class PictureWarning(Answer):
    """Something about the pictures that makes the answer worse or wrong."""

    code: str = Field(description="A name that never changes.")
    message: str = Field(description="What was seen, what it does to the answer, and what to do.")
    pictures: list[int] = Field([], description="Numbers of the images, from 0; empty for all.")


class TimingMs(Answer):
    """Where the time of samples went, in ms."""

    decode: float
    encode: float
    generate: float
    total: float


class ScoreTimingMs(Answer):
    """Where the time of scores went, in ms."""

    decode: float
    encode: float
    score: float
    total: float


class PlanTimingMs(ScoreTimingMs):
    """Where the time of a plan went, in ms."""

    search: float


class DoctorTimingMs(Answer):
    """Where the time of a diagnosis went, in ms."""

    diagnose: float
    novelty: float
    total: float


class SceneAnswer(Answer):
    """What every answer about pictures says of them and of the model."""

    scenario: ScenarioInfo
    warnings: list[PictureWarning] = Field([], description="Problems of the pictures.")
    joint_space: JointSpaceInfo
    model: ModelInfo


class ProposalCounts(Answer):
    """How many configurations were proposed, and how many of them are in the answer, by their kind."""

    generator: int
    generator_kept: int
    uniform: int
    uniform_kept: int


class SampleAnswer(SceneAnswer):
    """Samples for a picture."""

    samples: Float32Rows = Field(description="Configurations, rad.")
    confidence: Float32s | None = Field(description="The validity head's score of each sample.")
    unseen: Float32s | None = Field(None, description="Share of the robot in unseen space.")
    ways: list[int] | None = Field(None, description="Path models that search: the path of each sample.")
    shortfall: int = Field(description="n minus the number of samples.")
    acceptance: float = Field(description="Share of the proposals that reached the confidence.")
    proposals: ProposalCounts | None = Field(
        None, exclude_if=_absent, description="By their kind; absent for samples along paths."
    )
    seed: SeedText = Field(description="That was used, in decimal.")
    timing_ms: TimingMs


class Contact(Answer):
    """What is in the way of a configuration."""

    kind: Literal["known", "self", "seen", "hidden", "unread", "out of view"] = Field(
        description="The last three are unknown space."
    )
    link: str = Field(description="The part of the robot, or the attached body.")
    other: str = Field(description="The body or part that it touches; empty for what pictures show.")
    position_m: list[float] = Field(description="Of the place on the robot, in its base frame.")
    depth_m: float = Field(description="How deep it is in; 0 in unknown space.")
    text: str = Field(description="In words.")


class ValidityAnswer(SceneAnswer):
    """What a model predicts for configurations."""

    confidence: Float32s = Field(description="The probability that each configuration is free.")
    unseen: Float32s | None = Field(description="Share of the robot in unseen space; null in a plane.")
    threshold: float | None = Field(description="The default `min_confidence` of samples; null without one.")
    why: list[Contact | None] | None = Field(None, exclude_if=_absent, description="What is in the way.")
    timing_ms: ScoreTimingMs


class BeliefAnswer(SceneAnswer):
    """The probability that something is in each cell of a grid in the robot's base."""

    low_m: list[float] = Field(description="The grid's lowest corner, x, y and z.")
    cell_m: float = Field(description="Side of a cell.")
    counts: list[int] = Field(description="Cells along x, y and z.")
    occupied: str = Field(
        json_schema_extra={"contentEncoding": "base64"}, description="Base64 of a byte a cell, z the fastest."
    )
    timing_ms: ScoreTimingMs


class Verdict(Answer):
    """Something that is wrong with the pictures, or may be."""

    code: str = Field(description="A name that never changes.")
    seen: str = Field(description="What was seen.")
    effect: str = Field(description="What it does to answers.")
    remedy: str = Field(description="What to do.")
    pictures: list[int] = Field([], description="Numbers of the images, from 0; empty for all.")


class SuggestedPose(Answer):
    """Where a camera seems to be instead of where it was said to be."""

    picture: int = Field(description="Number of its image, from 0.")
    pose: Rows = Field(description="4 x 4, of the optical frame in the robot's base, m.")
    offset_m: float = Field(description="Its distance from the pose that was sent.")
    turn_deg: float = Field(description="How far it is turned from there.")


class DoctorAnswer(Answer):
    """What a close look at the pictures finds."""

    verdicts: list[Verdict] = Field(description="Empty where nothing wrong was found.")
    notes: list[str] = Field(description="What is not wrong, or could not be tested.")
    poses: list[SuggestedPose] = Field(description="Of cameras with a clearly better pose.")
    scenario: ScenarioInfo
    model: ModelInfo
    timing_ms: DoctorTimingMs


class LeastSure(Answer):
    """Where the best path has its lowest confidence."""

    configuration: Numbers = Field(description="rad.")
    confidence: float = Field(description="Of this configuration alone.")
    unseen: float | None = Field(description="Share of the robot there that no picture shows.")
    along: float = Field(description="How far along the path, 0 to 1.")


class Alternative(Answer):
    """A path of sufficient confidence."""

    path: Rows
    confidence: float
    edges: Float32s


class Trajectory(Answer):
    """Points in time; between them each joint's acceleration is constant."""

    times_s: Numbers = Field(description="From 0.")
    positions: Rows = Field(description="rad; circles go on beyond [-pi, pi).")
    velocities: Rows = Field(description="rad/s; 0 at both ends.")


class PlanAnswer(SceneAnswer):
    """A path, or why there is none."""

    status: Literal["solved", "refused", "timeout"] = Field(
        description="`refused`: none is confident enough."
    )
    reason: str | None = Field(description="Why it is not solved, in words.")
    path: Rows = Field(description="From start to goal, straight in between, rad; empty unless solved.")
    trajectory: Trajectory | None = Field(None, exclude_if=_absent, description="The path in time.")
    confidence: float = Field(description="That the whole path is free.")
    receipt: str | None = Field(None, exclude_if=_absent, description="Sent back with outcomes.")
    kept: bool | None = Field(None, exclude_if=_absent, description="Whether the server keeps it.")
    edges: Float32s = Field(description="The lowest confidence on each edge of the path.")
    unseen: Float32s | None = Field(description="Of each edge, the largest share of the robot.")
    length_rad: float
    ways: int = Field(description="Paths that were found.")
    least_sure: LeastSure | None
    contact: Contact | None = Field(None, exclude_if=_absent, description="What is in the way.")
    alternatives: list[Alternative] | None = Field(description="The best first; null unless requested.")
    seed: SeedText = Field(description="That was used, in decimal.")
    timing_ms: PlanTimingMs


class OutcomesAnswer(Answer):
    """What was done with a batch."""

    kept: int = Field(description="Outcomes that were taken: all, or 0 if the disk does not keep up.")


class FieldProblem(Answer):
    """What is wrong with one field."""

    field: str
    expected: str
    got: str


class Problem(Answer):
    """RFC 9457 problem details."""

    type: str
    title: str
    status: int
    detail: str
    expected: str | None = None
    got: str | None = None
    remedy: str | None = None
    errors: list[FieldProblem] | None = None
