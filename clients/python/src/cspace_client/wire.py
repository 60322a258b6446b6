"""Requests and answers of the HTTP API as pydantic models: one definition for server and client.

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
MAX_PICTURES, MAX_VIEWS, MAX_PATHS, MAX_TIME_S = 4, 64, 64, 10.0
MAX_BODIES, MAX_ATTACHED, MAX_IGNORED, MAX_PAIRS, MAX_MESHES = 500, 16, 64, 1000, 32

FORM_TEXTS = frozenset({"model", "robot", "seed"})
"""Fields of a form that are plain text. All others are JSON, or files: `image`, `mesh`, `configurations`."""
FORM_REPEATED = frozenset({"image", "camera", "epsilon_sigma", "view"})
"""Fields that a form may repeat."""

DIGEST, NAME = "[0-9a-f]{64}", "[A-Za-z0-9][A-Za-z0-9-]{0,62}"


def _listed(value: object) -> object:
    """Arrays and tuples as lists; the rest is pydantic's to check."""
    return (
        value.tolist()
        if isinstance(value, np.ndarray)
        else list(value)
        if isinstance(value, tuple)
        else value
    )


def _one_or_more(value: object) -> object:
    value = _listed(value)
    return value if isinstance(value, list) else [value]


def _from_base64(value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError("not base64") from error


def _parse_seed(value: object) -> object:
    return int(value) if isinstance(value, str) and re.fullmatch("[0-9]{1,20}", value, re.ASCII) else value


Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3), BeforeValidator(_listed)]
Quaternion = Annotated[list[Number], Field(min_length=4, max_length=4), BeforeValidator(_listed)]
Matrix = Annotated[list[Quaternion], Field(min_length=4, max_length=4), BeforeValidator(_listed)]
Configuration = Annotated[list[Number], Field(max_length=MAX_JOINTS), BeforeValidator(_listed)]
Range = Annotated[list[Number], Field(min_length=2, max_length=2), BeforeValidator(_listed)]
PartName = Annotated[str, Field(min_length=1, max_length=100)]
Seed = Annotated[
    Annotated[int, Field(ge=0, le=MAX_SEED)] | None,
    BeforeValidator(_parse_seed),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "integer", "minimum": 0, "maximum": MAX_SEED},
                {"type": "string", "pattern": "^[0-9]{1,20}$"},
                {"type": "null"},
            ]
        }
    ),
]
_SEED_FIELD = Field(
    default=None, description="Unsigned 64 bit as number or decimal text; drawn and returned when absent."
)


class Request(BaseModel):
    """Base of requests and their parts."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Pose(Request):
    """A place in m and a rotation."""

    translation: Vector
    quaternion_xyzw: Quaternion = Field(default=[0.0, 0.0, 0.0, 1.0], description="With a norm of 1.")


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
    camera_info: dict[str, Any] | str | None = Field(
        default=None,
        description="In place of the four numbers: a ROS CameraInfo, or its text in YAML or JSON.",
    )
    pose: AnyPose = Field(description="4 x 4, m, or `translation` and `quaternion_xyzw`.")
    frame: Literal["optical", "body"] = Field(
        default="optical",
        description="Of the camera: optical (x right, y down, z forward) or body (x forward, y left, z up).",
    )
    link: str | None = Field(
        default=None, description="The joint, link or `tool` whose frame `pose` is in; absent, the base."
    )
    stamp_s: Number | None = Field(default=None, description="Of the picture, seconds since the epoch.")

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
    pose: AnyPose | None = Field(default=None, description="As of a camera; absent, the frame itself.")

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
    link: PartName = Field(default="tool", description="The part of the robot whose frame `pose` is in.")
    touch_links: list[PartName] = Field(default=[], max_length=100, description="Parts that it may touch.")


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
Picture = Annotated[
    bytes,
    BeforeValidator(_from_base64),
    WithJsonSchema({"type": "string", "contentEncoding": "base64"}),
]


class KnownFields(Request):
    """What is known of a scene beside its pictures."""

    scene: list[Body] = Field(
        default=[], max_length=MAX_BODIES, description="Bodies in the base frame, whatever the pictures show."
    )
    attached: list[AttachedBody] = Field(
        default=[],
        max_length=MAX_ATTACHED,
        description="Bodies that the arm holds. Their pixels are removed as the arm's are.",
    )
    allowed: list[Annotated[list[PartName], Field(min_length=2, max_length=2), BeforeValidator(_listed)]] = (
        Field(
            default=[],
            max_length=MAX_PAIRS,
            description="Pairs of names, of parts and bodies, that may touch.",
        )
    )
    ignore: list[Volume] = Field(
        default=[], max_length=MAX_IGNORED, description="Volumes that count as free, whatever pictures show."
    )
    meshes: dict[PartName, str] = Field(
        default={},
        max_length=MAX_MESHES,
        description="Binary STL in base64 by the names that `mesh` gives. In a form files, parts `mesh`.",
    )


class SceneFields(KnownFields):
    """What shows the scene, and the model that is asked."""

    image: Annotated[list[Picture], Field(min_length=1, max_length=16), BeforeValidator(_one_or_more)] = (
        Field(
            description="A square PNG of 16 to 2048 pixels. For models of depth cameras 1 to "
            f"{MAX_PICTURES} pictures of depths along the optical axis: 16-bit grey PNGs of mm, 0 for no "
            "reading, or float32 metres as TIFF or `.npy`. In a form files, in JSON base64.",
        )
    )
    camera: Annotated[list[Camera], Field(max_length=16), BeforeValidator(_one_or_more)] = Field(
        default=[], description="For depth pictures and only for them, one for each image in the same order."
    )
    state: State | None = Field(
        default=None,
        description="Where the robot was when the pictures were taken, rad; absent, it is in none of them. "
        "An array of such arrays, or nulls, has one for each image.",
    )
    max_age_s: Positive | None = Field(
        default=None, description="Refuses pictures that are older, by `stamp_s` and the server's clock."
    )
    depth_scale_m: Annotated[float, Field(ge=1e-6, le=1.0, allow_inf_nan=False)] | None = Field(
        default=None, description="Metres per unit of the depth pictures: 0.001 when absent, 1 for floats."
    )
    model: Annotated[str, Field(max_length=300)] | None = Field(
        default=None,
        description="`name` (its champion), `name@alias`, `name/version`, or `pretrained` (shipped).",
    )
    robot: Annotated[str, Field(pattern=f"^({DIGEST}|{NAME})$")] | None = Field(
        default=None,
        description="Digest of the robot that is planned for: a model of another one answers 409. Without "
        "`model` also a robot's name, such as `panda`: the champion of its models answers.",
    )

    @model_validator(mode="after")
    def _name_without_model(self) -> Self:
        if self.robot is not None and self.model is not None and not re.fullmatch(DIGEST, self.robot):
            raise ValueError("robot is a digest where a model is named")
        return self


class SampleFields(Request):
    """What is asked of a sampler."""

    n: int = Field(default=300, ge=1, le=MAX_SAMPLES, description="How many samples.")
    seed: Seed = _SEED_FIELD
    epsilon_sigma: Annotated[
        list[Annotated[float, Field(ge=0.0, le=MAX_EPSILON, allow_inf_nan=False)]],
        Field(min_length=1, max_length=MAX_EPSILONS),
        BeforeValidator(_one_or_more),
    ] = Field(
        default=[0.0],
        description="Added to the encoder's standard deviation; several values share the samples equally.",
    )
    start: Configuration | None = Field(default=None, description="For path models and only for them, rad.")
    goal: Configuration | None = Field(default=None, description="As `start`.")
    min_confidence: Share | None = Field(
        default=None,
        description="Least confidence of a sample. Absent, the model's threshold; 0 returns all samples.",
    )


class PlanFields(Request):
    """What is asked of a planner."""

    start: Configuration = Field(description="Where the path begins, rad.")
    goal: Configuration | None = Field(default=None, description="Where it ends; either this or `goal_pose`.")
    goal_pose: "GoalPose | None" = Field(default=None, description="Of arms in space: where the tool ends.")
    limits: Annotated[list[Range | None], Field(max_length=MAX_JOINTS)] | None = Field(
        default=None,
        description="For each joint `[low, high]` in rad, or null for its own, all along the path.",
    )
    upright: "Upright | None" = Field(
        default=None, description="Of arms in space: an axis that stays upright."
    )
    unwrapped: bool = Field(
        default=False,
        description="Whether circles go on beyond [-pi, pi) along the path, from `start` as sent.",
    )
    seed: Seed = _SEED_FIELD
    min_confidence: Share | None = Field(
        default=None,
        description="Least confidence of the path. Absent, 0.2 where plans are calibrated, else 0.",
    )
    max_risk: Share | None = Field(
        default=None,
        description="In place of `min_confidence`: the greatest probability that the path collides.",
    )
    time_limit_s: Annotated[float, Field(ge=0.01, le=MAX_TIME_S, allow_inf_nan=False)] = Field(
        default=1.0, description="Of search and refinement."
    )
    ways: int = Field(default=4, ge=1, le=MAX_PATHS, description="Number of paths to search for.")
    alternatives: bool = Field(default=False, description="Return all paths of sufficient confidence.")
    explain: bool = Field(
        default=False, description="Say in `contact` what is in the way where there is no path."
    )
    keep: bool = Field(
        default=False, description="Allow the server to keep pictures and path of a solved plan for training."
    )
    next_view: bool = Field(
        default=False, description="Name the camera that would see most of unknown space."
    )
    view: Annotated[list[View], Field(max_length=MAX_VIEWS), BeforeValidator(_one_or_more)] = Field(
        default=[], description="Cameras to choose it from. Absent, places of training cameras."
    )


class GoalPose(Request):
    """Where the tool's frame shall be in the end, in the robot's base."""

    pose: AnyPose
    tolerance_m: Annotated[float, Field(ge=1e-4, le=1.0)] = 0.005
    tolerance_rad: Annotated[float, Field(ge=1e-3, le=np.pi)] = 0.05
    free_z_rotation: bool = Field(
        default=False, description="Whether any turn about the frame's z axis will do."
    )


class Upright(Request):
    """An axis in the tool's frame that stays within `max_rad` of `up` in the base."""

    axis: Vector
    max_rad: Annotated[float, Field(ge=1e-3, le=np.pi)]
    up: Vector = [0.0, 0.0, 1.0]


class SampleRequest(SampleFields, SceneFields):
    """A request for samples."""


class PlanRequest(PlanFields, SceneFields):
    """A request for a path."""


class ValidityRequest(SceneFields):
    """A request for the confidence of configurations."""

    configurations: Annotated[
        bytes
        | Annotated[
            list[Annotated[list[Number], Field(min_length=1, max_length=MAX_JOINTS)]],
            Field(min_length=1, max_length=MAX_SAMPLES),
        ],
        WithJsonSchema(
            {
                "type": "array",
                "items": {
                    "type": "array",
                    "items": {"type": "number"},
                    "minItems": 1,
                    "maxItems": MAX_JOINTS,
                },
                "minItems": 1,
                "maxItems": MAX_SAMPLES,
            }
        ),
    ] = Field(description="Rows in rad: JSON, or in a form a `.npy` file, float32 or float64 (n, joints).")
    explain: bool = Field(
        default=False,
        description=f"Say in `why` what is in the way of each below 0.5; at most {MAX_EXPLAINED} rows.",
    )


class BeliefRequest(SceneFields):
    """A request for the probability that something is in each cell of space."""


class DoctorRequest(SceneFields):
    """A request for a diagnosis of pictures, cameras and state."""


class _Outcome(Request):
    request_id: Annotated[str, Field(pattern="^[A-Za-z0-9._-]{1,128}$")] = Field(
        description="The `X-Request-ID` of the answer."
    )
    model: Annotated[str, Field(pattern="^[A-Za-z0-9][A-Za-z0-9._-]{0,99}/[0-9]{1,9}$")] = Field(
        description="The model that answered, as `name/version`."
    )
    receipt: Annotated[str, Field(max_length=1000)] | None = Field(
        default=None, description="That the answer carried."
    )
    stamp_s: Annotated[float, Field(ge=0.0, le=1e10)] | None = Field(
        default=None, description="When this was known, seconds since the epoch."
    )
    confidence: Share | None = Field(default=None, description="That the answer stated.")
    novelty: Share | None = Field(default=None, description="That the answer stated.")
    site: Annotated[str, Field(pattern="^[A-Za-z0-9._-]{1,64}$")] | None = Field(
        default=None, description="A short name of the place, such as a cell's."
    )


class PlanOutcome(_Outcome):
    """What became of an answer of `POST /plan`."""

    kind: Literal["plan"] = "plan"
    success: bool = Field(description="Whether the path was free, or was executed to its end.")
    executed: bool | None = Field(default=None, description="Whether a robot moved along the path.")
    collided: bool | None = Field(
        default=None, description="Whether the path collides, in the world or for an exact check."
    )
    collided_at: Share | None = Field(
        default=None, description="Where it collides first: the share of the path's length from its start."
    )
    time_s: Annotated[float, Field(ge=0.0, le=1e10)] | None = Field(
        default=None, description="From the request to this outcome."
    )

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
SeedText = Annotated[
    int, PlainSerializer(str), WithJsonSchema({"type": "string", "pattern": "^[0-9]{1,20}$"})
]
LEFT_OUT: Any = Field(default=None, exclude_if=lambda value: value is None)


class Answer(BaseModel):
    """Base of answers and their parts."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class JointSpaceInfo(Answer):
    """The space that configurations live in; ranges only where a joint has limits."""

    kind: Literal["torus", "box", "mixed"] = Field(description="All circles, none, or some.")
    dim: int
    unit: Literal["rad"] = "rad"
    lower: Annotated[list[float] | None, LEFT_OUT] = None
    upper: Annotated[list[float] | None, LEFT_OUT] = None
    periodic: Annotated[list[bool] | None, LEFT_OUT] = Field(
        default=None, description="Whether each joint is a circle."
    )


class ModelInfo(Answer):
    """The model that answered."""

    name: str
    version: int = Field(description="Number in the registry; 0 for a shipped model.")
    alias: str | None = Field(default=None, description="By which it was found.")
    run_id: str | None = None
    digest: str = Field(description="SHA-256 of the bundle's sums.")
    fallback: bool = Field(default=False, description="Whether a shipped model stands in for a champion.")
    robot: str | None = Field(default=None, description="SHA-256 of the robot in `GET /models`.")
    alias_confirmed: bool = Field(
        default=True,
        description="False if the alias may have moved: the registry is away, or it is not loaded.",
    )


class ScenarioInfo(Answer):
    """What the model makes of the picture."""

    novelty: float | None = Field(
        default=None, description="Share of known pictures that are less unusual, 0 to 1; null if not known."
    )


class PictureWarning(Answer):
    """Something about the pictures that makes the answer worse or wrong."""

    code: str = Field(description="A name that never changes.")
    message: str = Field(description="What was seen, what it does to the answer, and what to do.")
    pictures: list[int] = Field(default=[], description="Numbers of the images, from 0; empty for all.")


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
    warnings: list[PictureWarning] = Field(
        default=[], description="What is wrong with the pictures, or may be."
    )
    joint_space: JointSpaceInfo
    model: ModelInfo


class SampleAnswer(SceneAnswer):
    """Samples for a picture."""

    samples: Float32Rows = Field(
        description="Configurations in rad, circles in [-pi, pi), other joints within their limits."
    )
    confidence: Float32s | None = Field(description="The validity head's score of each sample.")
    unseen: Float32s | None = Field(
        default=None, description="Share of the robot in unseen space, of each sample; null in a plane."
    )
    ways: list[int] | None = Field(
        default=None, description="Path models that search: the path of each sample, 0 for the surest."
    )
    shortfall: int = Field(description="n minus the number of samples.")
    acceptance: float = Field(description="Share of the proposals that reached the confidence.")
    seed: SeedText = Field(description="That was used, in decimal.")
    timing_ms: TimingMs


class Contact(Answer):
    """What is in the way of a configuration."""

    kind: Literal["known", "self", "seen", "hidden", "unread", "out of view"] = Field(
        description="A known body, the robot itself, a seen surface; or unknown space: hidden behind one, "
        "without a reading, or out of view."
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
    why: Annotated[list[Contact | None] | None, LEFT_OUT] = Field(
        default=None, description="With `explain`: what is in the way of each; null of those that pass."
    )
    timing_ms: ScoreTimingMs


class BeliefAnswer(SceneAnswer):
    """The probability that something is in each cell of a grid in the robot's base."""

    low_m: list[float] = Field(description="The grid's lowest corner, x, y and z.")
    cell_m: float = Field(description="Side of a cell.")
    counts: list[int] = Field(description="Cells along x, y and z.")
    occupied: str = Field(
        description="The probability in 1/255: base64 of a byte for each cell, z the fastest, x the slowest.",
        json_schema_extra={"contentEncoding": "base64"},
    )
    timing_ms: ScoreTimingMs


class Verdict(Answer):
    """Something that is wrong with the pictures, or may be."""

    code: str = Field(description="A name that never changes.")
    seen: str = Field(description="What was seen.")
    effect: str = Field(description="What it does to answers.")
    remedy: str = Field(description="What to do.")
    pictures: list[int] = Field(default=[], description="Numbers of the images, from 0; empty for all.")


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


class NextView(Answer):
    """A camera that would see more."""

    camera: View
    sees: float = Field(description="Share of the path's cost that lies on space it would see.")


class PlanAnswer(SceneAnswer):
    """A path, or why there is none."""

    status: Literal["solved", "refused", "timeout"] = Field(
        description="`refused` without a path or enough confidence, `timeout` if the time ended first."
    )
    reason: str | None = Field(description="Why it is not solved, in words.")
    path: Rows = Field(description="From start to goal, straight in between, rad; empty unless solved.")
    confidence: float = Field(
        description="Estimated probability that the whole path is free; of the best path where it is refused."
    )
    receipt: Annotated[str | None, LEFT_OUT] = Field(
        default=None, description="To be sent back with the outcome of this plan."
    )
    kept: Annotated[bool | None, LEFT_OUT] = Field(
        default=None, description="With `keep`: whether the server keeps pictures and path."
    )
    edges: Float32s = Field(description="The lowest confidence on each edge of the path.")
    unseen: Float32s | None = Field(
        description="The largest share of the robot on each edge that no picture shows; null in a plane."
    )
    length_rad: float
    ways: int = Field(description="Paths that were found.")
    least_sure: LeastSure | None
    contact: Annotated[Contact | None, LEFT_OUT] = Field(
        default=None, description="What is in the way, of an answer without a path."
    )
    alternatives: list[Alternative] | None = Field(
        description="All paths of sufficient confidence, the best first; null where not requested."
    )
    next_view: NextView | None = Field(
        description="Of the best path; null where not requested or none helps."
    )
    seed: SeedText = Field(description="That was used, in decimal.")
    timing_ms: PlanTimingMs


class OutcomesAnswer(Answer):
    """What was done with a batch."""

    kept: int = Field(description="Outcomes that were taken: all, or 0 if the disk does not keep up.")


class ListedModel(Answer):
    """A model that a request can name."""

    reference: str = Field(description="What to write into `model`.")
    name: str
    version: int
    aliases: list[str]
    run_id: str | None
    digest: str
    loaded: bool = Field(description="Whether it is in memory.")
    default: bool = Field(description="Whether it answers requests that name no model.")
    robot: str | None = Field(description="SHA-256 of the robot; null where it is not known before loading.")
    world: dict[str, Any] | None = Field(
        description="Robot, limits and camera; null as `robot` is, and where they are too long."
    )
    joint_space: JointSpaceInfo | None = Field(description="As in an answer; null as `world` is.")


class ModelsAnswer(Answer):
    """The models that requests can name."""

    default: str
    registry: Literal["none", "reachable", "unreachable"]
    models: list[ListedModel]


class Live(Answer):
    """The process answers."""

    status: Literal["live"] = "live"


class Ready(Answer):
    """The default model answers."""

    status: Literal["ready"] = "ready"
    registry: Literal["none", "reachable", "unreachable"]
    successor: Literal["none", "pending", "refused"] = Field(
        description="Whether a champion is not served yet, or is refused."
    )
    model: ModelInfo


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
