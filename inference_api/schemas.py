"""Requests and answers of the API as pydantic models; OpenAPI is generated from them.

The fields of a request stand here once: with their types, their bounds, and the words that an error uses.
"""

import base64
import binascii
import json
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    ValidationError,
    WithJsonSchema,
    model_validator,
)

from cspace.errors import InputError
from cspace.query import (
    DEFAULT_PATHS,
    DIGEST_PATTERN,
    MAX_EPSILON,
    MAX_SAMPLES,
    MAX_SEED,
    PLAIN,
    SampleQuery,
    random_seed,
)
from cspace.strict_json import LEFT_OUT
from cspace.view_file import (
    MAX_ATTACHED,
    MAX_BODIES,
    MAX_IGNORED,
    MAX_MESHES,
    MAX_PAIRS,
    MAX_PICTURES,
    MAX_TRIANGLES,
    check_ages,
    is_view,
    pack_view,
    unstamped,
    without_stamps,
)
from cspace.world import Contact, Finding
from inference_api.models.served import ServedModel
from inference_api.problem_types import FieldProblem, FieldsError, brief
from services.names import ROBOT_NAME, SITE_PATTERN, model_of
from services.registry.entities import ModelReference

MAX_JOINTS, MAX_EPSILONS, MAX_VIEWS = 64, 1000, 64
MIN_SCALE_M, MAX_SCALE_M = 1e-6, 1.0
MAX_EXPLAINED = 1000
LEAST_TIME_S, MAX_TIME_S, MAX_PATHS = 0.01, 10.0, 64
# Wrong fields that one answer reports.
MAX_REPORTED = 8
# More than a world takes, so that too many are refused by the world, in its words.
_MOST_PICTURES = 16
_SEED = re.compile(r"[0-9]{1,20}", re.ASCII)


@dataclass(frozen=True, slots=True)
class Expected:
    """What an error says that a field takes."""

    text: str


Site = Annotated[
    Annotated[str, Field(pattern=f"^{SITE_PATTERN}$")] | None,
    Expected("1 to 64 letters, digits, dots, dashes and underscores"),
]


def _parse_seed(value: object) -> object:
    return int(value) if isinstance(value, str) and _SEED.fullmatch(value) else value


def _as_list(value: object) -> object:
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


def _as_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else (value,)


def _decode_image(value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise ValueError("not base64") from error


def _one_or_many(schema: dict[str, Any], most: int, least: int = 0) -> WithJsonSchema:
    many = {"type": "array", "items": schema, "minItems": least, "maxItems": most}
    return WithJsonSchema({"anyOf": [schema, many]})


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}


def _numbers(count: int, items: dict[str, Any] = _NUMBER) -> dict[str, Any]:
    return {"type": "array", "items": items, "minItems": count, "maxItems": count}


def _object(properties: dict[str, Any], **optional: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties | optional,
        "required": list(properties),
        "additionalProperties": False,
    }


_POSE = _numbers(4, _numbers(4))
_ANY_POSE = {
    "pose": {"anyOf": [_POSE, _object({"translation": _numbers(3), "quaternion_xyzw": _numbers(4)})]}
}
_OPTIONAL: dict[str, Any] = {
    "frame": {"enum": ["optical", "body"]},
    "link": {"type": "string"},
    "stamp_s": _NUMBER,
}
_PINHOLE = dict.fromkeys(("fx", "fy", "cx", "cy"), _NUMBER)
_CAMERA = {
    "anyOf": [
        _object(_PINHOLE | _ANY_POSE, **_OPTIONAL),
        _object({"camera_info": {"type": ["object", "string"]}} | _ANY_POSE, **_OPTIONAL),
    ]
}
_VIEW = _object(_PINHOLE | {name: {"type": "integer"} for name in ("width", "height")} | {"pose": _POSE})


Number = Annotated[float, Field(allow_inf_nan=False)]
Configuration = Annotated[tuple[Number, ...], Field(max_length=MAX_JOINTS), Strict(strict=False)]
ModelName = Annotated[
    str,
    Field(max_length=300),
    Expected("name, name@alias, name/version or pretrained"),
]
Seed = Annotated[
    Annotated[int, Field(ge=0, le=MAX_SEED)] | None,
    BeforeValidator(_parse_seed),
    Expected("an unsigned 64-bit whole number, or its decimal digits as text"),
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
Robot = Annotated[
    Annotated[str, Field(pattern=f"^{DIGEST_PATTERN}$")] | None,
    Expected("64 hexadecimal digits, small letters"),
]
_RobotOrName = Annotated[
    Annotated[str, Field(pattern=f"^{DIGEST_PATTERN}$")] | None,
    Expected("64 hexadecimal digits, small letters; without `model` also a robot's name"),
    WithJsonSchema(
        {"anyOf": [{"type": "string", "pattern": f"^({DIGEST_PATTERN}|{ROBOT_NAME})$"}, {"type": "null"}]}
    ),
]
_ROBOT: Any = Field(
    None,
    description="The robot that is planned for, as `model.robot` of an answer has it: a model of another one "
    "refuses with 409. Absent, whichever robot the model is of. Without `model` also its name, such as "
    "`panda`: the champion of its models answers.",
)
Confidence = Annotated[
    Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] | None,
    Expected("a finite number from 0 to 1"),
]
_Epsilon = Annotated[float, Field(ge=0.0, le=MAX_EPSILON, allow_inf_nan=False)]
_Schedule = Annotated[
    Annotated[tuple[_Epsilon, ...], Field(min_length=1, max_length=MAX_EPSILONS), Strict(strict=False)],
    BeforeValidator(_as_list),
    Expected(f"one or more finite numbers from 0 to {MAX_EPSILON:g}"),
    _one_or_many({"type": "number", "minimum": 0, "maximum": MAX_EPSILON}, MAX_EPSILONS, 1),
]
_Images = Annotated[
    Annotated[
        tuple[Annotated[bytes, BeforeValidator(_decode_image)], ...],
        Field(min_length=1, max_length=_MOST_PICTURES),
    ],
    BeforeValidator(_as_tuple),
    Expected(
        "a PNG: a file in a form, base64 text in JSON; of depth cameras several, each with a camera, also "
        "TIFF and .npy of floats"
    ),
    _one_or_many({"type": "string", "contentEncoding": "base64"}, MAX_PICTURES, 1),
]


def _whose(state: object) -> str:
    each = isinstance(state, list | tuple) and any(one is None or isinstance(one, list) for one in state)
    return "each" if each else "one"


_EachState = Annotated[
    tuple[Configuration | None, ...], Field(max_length=_MOST_PICTURES), Strict(strict=False)
]
_State = Annotated[
    Annotated[Configuration, Tag("one")] | Annotated[_EachState, Tag("each")], Discriminator(_whose)
]
# What is in a camera is checked by the world that has cameras.
_Cameras = Annotated[
    Annotated[tuple[dict[str, Any], ...], Field(max_length=_MOST_PICTURES)],
    BeforeValidator(_as_tuple),
    Expected("objects of fx, fy, cx, cy, or of camera_info, with pose, one for each image"),
    _one_or_many(_CAMERA, MAX_PICTURES),
]
_Views = Annotated[
    Annotated[tuple[dict[str, Any], ...], Field(max_length=MAX_VIEWS)],
    BeforeValidator(_as_tuple),
    Expected(f"at most {MAX_VIEWS} objects of fx, fy, cx, cy, width, height and pose"),
    _one_or_many(_VIEW, MAX_VIEWS),
]
_Row = Annotated[tuple[Number, ...], Field(min_length=1, max_length=MAX_JOINTS), Strict(strict=False)]
_Configurations = Annotated[
    bytes | Annotated[tuple[_Row, ...], Field(min_length=1, max_length=MAX_SAMPLES), Strict(strict=False)],
    Expected(f"1 to {MAX_SAMPLES} arrays of finite angles in rad: JSON, or a .npy file in a form"),
    WithJsonSchema(
        {
            "type": "array",
            "items": {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": MAX_JOINTS},
            "minItems": 1,
            "maxItems": MAX_SAMPLES,
        }
    ),
]
_Angles = Expected("an array of finite angles in rad")
_Range = Annotated[tuple[Number, Number], Strict(strict=False)]
_Limits = Annotated[
    Annotated[tuple[_Range | None, ...], Field(max_length=MAX_JOINTS), Strict(strict=False)] | None,
    Expected("for each joint [low, high] in rad, or null"),
]


# What is in these is checked by the world that has a tool.
_GOAL_POSE = _object(
    _ANY_POSE, tolerance_m=_NUMBER, tolerance_rad=_NUMBER, free_z_rotation={"type": "boolean"}
)
_GoalPose = Annotated[
    dict[str, Any] | None,
    Expected("an object of pose, tolerance_m, tolerance_rad and free_z_rotation"),
    WithJsonSchema({"anyOf": [_GOAL_POSE, {"type": "null"}]}),
]
_UPRIGHT = _object({"axis": _numbers(3), "max_rad": _NUMBER}, up=_numbers(3))
_Upright = Annotated[
    dict[str, Any] | None,
    Expected("an object of axis, max_rad and up"),
    WithJsonSchema({"anyOf": [_UPRIGHT, {"type": "null"}]}),
]


# What is in a body is checked by the world of the model.
_SHAPE = {
    "box": _object({"size_m": _numbers(3)}),
    "cylinder": _object({"radius_m": _NUMBER, "length_m": _NUMBER}),
    "sphere": _object({"radius_m": _NUMBER}),
    "mesh": _object({"file": _TEXT}, scale=_NUMBER),
}
_VOLUME = _object({}, name=_TEXT, pose=_ANY_POSE["pose"], **_SHAPE)
_DISC = _object(dict.fromkeys(("x_m", "y_m", "radius_m"), _NUMBER))
_BODY = _object({"name": _TEXT}, pose=_ANY_POSE["pose"], disc=_DISC, **_SHAPE)
_HELD = _object(
    {"name": _TEXT},
    pose=_ANY_POSE["pose"],
    link=_TEXT,
    touch_links={"type": "array", "items": _TEXT},
    **_SHAPE,
)


_Pair = Annotated[tuple[str, str], Strict(strict=False)]
_Many = Annotated[tuple[dict[str, Any], ...], Strict(strict=False)]
_Scene = Annotated[
    Annotated[_Many, Field(max_length=MAX_BODIES)],
    Expected("an array of bodies: name, box, cylinder, sphere or mesh, and pose; in a plane name and disc"),
    WithJsonSchema({"type": "array", "items": _BODY, "maxItems": MAX_BODIES}),
]
_Attached = Annotated[
    Annotated[_Many, Field(max_length=MAX_ATTACHED)],
    Expected("an array of bodies with link and touch_links"),
    WithJsonSchema({"type": "array", "items": _HELD, "maxItems": MAX_ATTACHED}),
]
_Ignored = Annotated[
    Annotated[_Many, Field(max_length=MAX_IGNORED)],
    Expected("an array of volumes: box, cylinder, sphere or mesh, and pose"),
    WithJsonSchema({"type": "array", "items": _VOLUME, "maxItems": MAX_IGNORED}),
]


class RequestFields(BaseModel):
    """Fields of a request; unknown ones are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    # In a form these are texts; every other field that is no file is JSON.
    TEXTS: ClassVar = frozenset({"model", "robot", "seed"})

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> Self:
        """Validates field values.

        Raises:
            FieldsError: a field is unknown, missing or wrong.
        """
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            places = {name: place for place, name in enumerate(cls.model_fields)}
            wrong = error.errors(include_url=False, include_context=False)
            wrong.sort(key=lambda one: places.get(str(one["loc"][0]) if one["loc"] else "", len(places)))
            problems = [cls.problem_at(one["type"], one["loc"], one["input"]) for one in wrong[:MAX_REPORTED]]
            raise FieldsError(problems) from error

    @classmethod
    def problem_at(cls, kind: str, location: tuple[int | str, ...], value: object) -> FieldProblem:
        """What is wrong at a place, as pydantic tells it."""
        name = str(location[0])[:100] if location else ""
        if kind == "extra_forbidden":
            expected = f"one of {', '.join(cls.model_fields)}"
            return FieldProblem(field=name, expected=expected, got="an unknown field")
        got = "nothing" if kind == "missing" else brief(value)
        return FieldProblem(field=name, expected=cls.expected(name), got=got)

    @classmethod
    def expected(cls, name: str) -> str:
        """What a field takes, in words."""
        found = cls.model_fields.get(name)
        texts = (one.text for one in (found.metadata if found else ()) if isinstance(one, Expected))
        return next(texts, "another value")


class ModelFields(RequestFields):
    """A request that may name its model."""

    model: ModelName = Field(
        "",
        description="`name` (its champion), `name@alias`, `name/version`, or `pretrained` (shipped).",
    )

    def reference(self, default: str) -> ModelReference:
        """The model that is asked: ``default`` where the request names none.

        Raises:
            InputError: the name is none.
        """
        return ModelReference.parse(self.model if "model" in self.model_fields_set else default)


# Fields of what is known beside the pictures.
_KNOWN = ("scene", "attached", "allowed", "ignore", "meshes")


class SceneFields(ModelFields):
    """Fields that show the scene."""

    image: _Images = Field(
        description="The scenario as a square PNG of 16 to 2048 pixels: RGB as it is, RGBA over white, grey "
        "and palette as RGB; 16-bit and animated ones are refused. Resized by area averaging. For models of "
        f"depth cameras, 1 to {MAX_PICTURES} pictures of depths along the optical axis: 16-bit grey PNGs of "
        "mm, 0 for no reading, or float32 metres as TIFF or `.npy`, NaN or infinity for no reading; what is "
        "below 20 mm or beyond 10 m is none either."
    )
    camera: _Cameras = Field(
        (),
        description="For models of depth cameras and only for them, one for each image in the same order: "
        "focal lengths and centre in pixels, pixel centres at whole numbers, or `camera_info`, a ROS "
        "CameraInfo as an object or as text in YAML; and `pose` of the camera in the robot's base, m: 4 x 4, "
        "or `translation` and `quaternion_xyzw`, of the optical frame (x right, y down, z forward) unless "
        "`frame` is `body` (x forward, y left, z up). With `link`, a joint or link of the robot or `tool`, "
        "`pose` is in that frame, which the picture's `state` places. `stamp_s`: when the picture was taken, "
        "seconds since the epoch.",
    )
    state: Annotated[
        _State | None,
        Expected("an array of finite angles in rad, or an array with one, or null, for each image"),
    ] = Field(
        None,
        description="Where the robot was when the pictures were taken, rad; absent, it is in none of them. "
        "An array of such arrays has one for each image, or null for one without the robot.",
    )
    max_age_s: Annotated[
        Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None,
        Expected("a finite number of seconds above 0"),
    ] = Field(
        None,
        description="Refuse pictures that are older by the server's clock, or more than 1 s ahead of it; "
        "each camera needs `stamp_s`.",
    )
    depth_scale_m: Annotated[
        Annotated[float, Field(ge=MIN_SCALE_M, le=MAX_SCALE_M, allow_inf_nan=False)] | None,
        Expected(f"metres per unit of the depth pictures, {MIN_SCALE_M:g} to {MAX_SCALE_M:g}"),
    ] = Field(
        None,
        description="Metres that one unit of the depth pictures stands for: 0.001 (mm) when absent, 1 for "
        "floats; 0.0001 for tenths of a mm, 0.0002 for TUM RGB-D. Goes with `camera`.",
    )
    robot: _RobotOrName = _ROBOT

    scene: _Scene = Field(
        (),
        description="Bodies that are known to stand in the base frame, checked by their shapes, whatever the "
        "pictures show. For models of depth cameras each has a `name`, one of `box`, `cylinder` (about its "
        "own z), `sphere` or `mesh`, and `pose`, as of a camera; for planar models a `name` and a `disc`, at "
        "most 64 of them. Sizes in m.",
    )
    attached: _Attached = Field(
        (),
        description="Bodies that move with the arm, with their pose in the frame of `link`, a part of the "
        "robot or `tool`; they touch neither known bodies nor what is seen, nor the arm but for "
        "`touch_links`. Their pixels are taken out of the pictures as the arm's are.",
    )
    allowed: Annotated[
        Annotated[tuple[_Pair, ...], Field(max_length=MAX_PAIRS), Strict(strict=False)],
        Expected("an array of pairs of names"),
    ] = Field((), description="Pairs of names, of parts of the robot and of bodies, that may touch.")
    ignore: _Ignored = Field(
        (),
        description="Volumes that count as free, whatever the pictures show there: an object that is about "
        "to be grasped, or a region that you vouch for.",
    )
    meshes: Annotated[
        Annotated[dict[str, str], Field(max_length=MAX_MESHES)],
        Expected(f"at most {MAX_MESHES} binary STL files in base64 by name"),
    ] = Field(
        {},
        description=f"The files that `mesh` names: binary STL in base64, at most {MAX_TRIANGLES} triangles "
        "in all bodies together. In a form they are files, parts with the name `mesh`, by their file names.",
    )

    @property
    def has_known(self) -> bool:
        """Whether anything is known beside the pictures."""
        return any(getattr(self, name) for name in _KNOWN)

    @model_validator(mode="before")
    @classmethod
    def _named(cls, values: dict[str, Any]) -> dict[str, Any]:
        """A robot's name stands for its model."""
        robot = values.get("robot")
        if "model" in values or not isinstance(robot, str) or not re.fullmatch(ROBOT_NAME, robot, re.ASCII):
            return values
        return {**values, "robot": None, "model": model_of(robot)}

    def known(self) -> bytes | None:
        """JSON of the planning scene, which the world reads; None where nothing is known."""
        given = {name: value for name in _KNOWN if (value := getattr(self, name))}
        return json.dumps(given).encode() if given else None

    def picture(self) -> bytes:
        """The one file that a world reads as the picture of a scene.

        Stamps are not in it, so that the same picture is the same file.

        Raises:
            ImageError: there is not a camera for each of several images, or a picture is too old or from the
                future.
            InputError: several images come without cameras, or a unit of depths does, or there is a largest
                age and no stamp.
        """
        file, stamps = self._stamped()
        if self.max_age_s is not None:
            check_ages(stamps, self.max_age_s, time.time())
        return file

    def _stamped(self) -> tuple[bytes, list[float | None]]:
        known = self.known()
        if self.camera or self.state is not None or known is not None:
            cameras, stamps = unstamped(self.camera)
            return pack_view(self.image, cameras, self.state, self.depth_scale_m, known), stamps or [None]
        if self.depth_scale_m is not None:
            raise InputError(
                "depth_scale_m comes without a camera",
                expected="it beside camera, for depth pictures; a view file has it inside",
                got=f"{self.depth_scale_m:g}",
            )
        if len(self.image) > 1:
            raise InputError(
                "image is repeated",
                expected="one, or a camera for each",
                got=f"{len(self.image)} without cameras",
            )
        return without_stamps(self.image[0]) if is_view(self.image[0]) else (self.image[0], [None])


class QueryFields(RequestFields):
    """What is asked for one picture, whatever names the picture and the model."""

    n: Annotated[int, Expected(f"a whole number from 1 to {MAX_SAMPLES}")] = Field(
        300, ge=1, le=MAX_SAMPLES, description="How many samples."
    )
    seed: Seed = Field(
        None,
        description="Unsigned 64 bit as number or decimal string; drawn and returned when absent. "
        "The samples for a smaller n are not guaranteed to be a prefix.",
    )
    epsilon_sigma: _Schedule = Field(
        PLAIN,
        description="The encoder's standard deviation is raised by each value; equal shares of the samples "
        "in this order, the remainder to the first. Repeat the field of a form for several values.",
    )
    start: Annotated[Configuration | None, _Angles] = Field(
        None,
        description="Configuration in rad, for path models and only for them: circles are wrapped, other "
        "joints have to lie within their limits.",
    )
    goal: Annotated[Configuration | None, _Angles] = Field(None, description="As `start`.")
    min_confidence: Confidence = Field(
        None,
        description="What the model's validity head has to score; more are drawn for those that do not. "
        "Absent, the model's own threshold holds; 0 takes all; above 0 only for models that have a head.",
    )
    robot: Robot = Field(None, description="The robot that is planned for; others refuse with 409.")

    def query(self) -> SampleQuery:
        """The fields as the value that travels on; draws a seed that is absent."""
        values = {item.name: getattr(self, item.name) for item in fields(SampleQuery)}
        return SampleQuery(**values | {"seed": random_seed(self.seed)})


class SampleRequest(QueryFields, SceneFields):
    """A request for samples."""

    robot: _RobotOrName = _ROBOT


class ValidityRequest(SceneFields):
    """A question whether configurations are free."""

    explain: Annotated[bool, Expected("true or false")] = Field(
        default=False,
        description="Whether the answer says for each configuration whose confidence is below 0.5 what is in "
        f"the way; then at most {MAX_EXPLAINED} configurations.",
    )
    configurations: _Configurations = Field(
        description=f"1 to {MAX_SAMPLES} configurations in rad, circles at any turn, other joints within "
        "their limits. In JSON, or in a form as a `.npy` file: float32 or float64 of shape (n, joints)."
    )


class PlanRequest(SceneFields):
    """A question for a path."""

    start: Annotated[Configuration, _Angles] = Field(
        description="Where the path begins, rad: circles at any turn, other joints within their limits."
    )
    goal: Annotated[Configuration | None, _Angles] = Field(
        None, description="Where it ends, as `start`. Either this or `goal_pose` is sent."
    )
    goal_pose: _GoalPose = Field(
        None,
        description="Of arms in space, where the tool's frame ends: `pose` in the robot's base, as of "
        "`camera`; `tolerance_m`, 0.005 when absent; `tolerance_rad`, 0.05; and `free_z_rotation`, whether "
        "any turn about the frame's z axis will do. Paths to up to four configurations that reach it are "
        "compared.",
    )
    limits: _Limits = Field(
        None,
        description="For each joint `[low, high]` in rad, within its own limits, or null for these: the "
        "whole path keeps to them. A circle with a range is none: start, goal and path are numbers in it.",
    )
    upright: _Upright = Field(
        None,
        description="Of arms in space, an `axis` in the tool's frame that the whole path keeps within "
        "`max_rad` of `up` in the robot's base, 0 0 1 when absent.",
    )
    unwrapped: Annotated[bool, Expected("true or false")] = Field(
        default=False,
        description="Whether circles go on beyond [-pi, pi) along the path instead of jumping, from `start` "
        "as it was sent.",
    )
    seed: Seed = Field(None, description="As of `POST /sample`: of all draws of the search.")
    min_confidence: Confidence = Field(
        None,
        description="Below it no path is returned, but the reason why. Absent, 0.2 where plans of the model "
        "are calibrated, else 0.",
    )
    max_risk: Confidence = Field(
        None,
        description="In place of `min_confidence`: the greatest probability that the path collides.",
    )
    time_limit_s: Annotated[float, Expected(f"a finite number from {LEAST_TIME_S:g} to {MAX_TIME_S:g}")] = (
        Field(
            1.0,
            ge=LEAST_TIME_S,
            le=MAX_TIME_S,
            allow_inf_nan=False,
            description="Of the search; what is found by then is what is chosen from.",
        )
    )
    ways: Annotated[int, Expected(f"a whole number from 1 to {MAX_PATHS}")] = Field(
        DEFAULT_PATHS,
        ge=1,
        le=MAX_PATHS,
        description="Number of paths to search for; the one of highest confidence is chosen.",
    )
    alternatives: Annotated[bool, Expected("true or false")] = Field(
        default=False,
        description="Whether the answer holds all paths that reach the confidence, for own checks.",
    )
    explain: Annotated[bool, Expected("true or false")] = Field(
        default=False,
        description="Whether an answer without a path says in `contact` what is in the way; it does so, too, "
        "where bodies are known.",
    )
    keep: Annotated[bool, Expected("true or false")] = Field(
        default=False,
        description="Whether pictures and path may be kept, to train on what becomes of the plan. Servers "
        "do so for a time that is set there, for solved plans without known bodies, and say so in `kept`.",
    )
    next_view: Annotated[bool, Expected("true or false")] = Field(
        default=False,
        description="Whether the answer names the camera that would see most of the unseen space that lowers "
        "the path's confidence.",
    )
    view: _Views = Field(
        (),
        description="Cameras to choose it from, as `camera` with `width` and `height` in pixels; in a form "
        "repeat the field. Absent, some towards that space, from where cameras of the training stood. Those "
        "go first that look from elsewhere than `camera`, by 45 degrees.",
    )


class JointSpaceInfo(BaseModel):
    """The space that the samples live in: all joints are circles."""

    kind: Literal["torus"]
    dim: int
    unit: Literal["rad"]


class LimitedJointSpaceInfo(BaseModel):
    """The same where joints have limits: all of them in a box, some in a mixed space."""

    kind: Literal["box", "mixed"]
    dim: int
    unit: Literal["rad"]
    lower: list[float] = Field(description="Lower end of each joint's range; -pi of a circle.")
    upper: list[float] = Field(description="Upper end of each joint's range; pi of a circle.")
    periodic: list[bool] = Field(description="Whether each joint is a circle.")


AnyJointSpace = Annotated[JointSpaceInfo | LimitedJointSpaceInfo, Field(discriminator="kind")]


def joint_space_info(space: Mapping[str, Any]) -> JointSpaceInfo | LimitedJointSpaceInfo:
    """A bundle's joint space as answers describe it."""
    return JointSpaceInfo(**space) if space["kind"] == "torus" else LimitedJointSpaceInfo(**space)


class ModelInfo(BaseModel):
    """The model that answered."""

    name: str
    version: int = Field(description="Number in the registry; 0 for the shipped model.")
    alias: str | None = Field(description="By which it was found.")
    run_id: str | None
    digest: str = Field(description="SHA-256 of the bundle's sums.")
    fallback: bool = Field(description="Whether the shipped model stands in for a champion.")
    robot: str = Field(description="Whose configurations are sampled: SHA-256 of the robot in `GET /models`.")
    alias_confirmed: bool = Field(
        description="False where the registry is away, or its version is not loaded yet, so that the alias "
        "(the champion's where none is named) may stand for another version."
    )


def model_info(served: ServedModel) -> ModelInfo:
    """A served model as answers describe it."""
    return ModelInfo(
        name=served.name,
        version=served.version,
        alias=served.alias,
        run_id=served.run_id,
        digest=served.bundle.digest,
        fallback=served.fallback,
        robot=served.bundle.robot,
        alias_confirmed=served.confirmed,
    )


class ScenarioInfo(BaseModel):
    """What the model makes of the picture."""

    novelty: float | None = Field(
        description="How unlike the training scenarios it is: the share of known pictures that are less "
        "unusual, 0 to 1; null for a model that does not estimate it."
    )


class PictureWarning(BaseModel):
    """Something about the pictures that makes the answer worse or wrong."""

    code: str = Field(description="A name that never changes.")
    message: str = Field(description="What was seen, what it does to the answer, and what to do.")
    pictures: list[int] = Field(description="Numbers of the images that it is about, from 0; empty for all.")


def warnings_of(findings: Iterable[Finding]) -> list[PictureWarning]:
    """Findings as answers carry them, each code once."""
    once = {one.code: one for one in findings}
    return [PictureWarning.model_validate(one, from_attributes=True) for one in once.values()]


class TimingMs(BaseModel):
    """Where the time went, in ms."""

    decode: float
    encode: float
    generate: float
    total: float


class ScoreTimingMs(BaseModel):
    """Where the time went, in ms."""

    decode: float
    encode: float
    score: float
    total: float


class PlanTimingMs(BaseModel):
    """Where the time went, in ms."""

    decode: float
    encode: float
    search: float
    score: float
    total: float


class SceneAnswer(BaseModel):
    """What every answer about a picture says of the picture and of the model."""

    scenario: ScenarioInfo
    warnings: list[PictureWarning] = Field(
        description="What is wrong, or may be, with the pictures; empty where nothing was found."
    )
    joint_space: AnyJointSpace
    model: ModelInfo


def about(served: ServedModel, novelty: float | None, warnings: list[PictureWarning]) -> dict[str, Any]:
    """The members of a :class:`SceneAnswer`."""
    return {
        "scenario": ScenarioInfo(novelty=novelty),
        "warnings": warnings,
        "joint_space": joint_space_info(served.bundle.spec.joint_space),
        "model": model_info(served),
    }


class SampleAnswer(SceneAnswer):
    """Samples for one picture."""

    samples: list[list[float]] = Field(
        description="Configurations in rad, circles in [-pi, pi), other joints within their limits."
    )
    confidence: list[float] | None = Field(description="The validity head's score of each sample.")
    unseen: list[float] | None = Field(
        None,
        description="Share of the robot that would be where no picture shows what is there, of each sample; "
        "null for worlds that are seen whole.",
    )
    ways: list[int] | None = Field(
        None,
        description="The path from start to goal that each sample lies along, 0 for the one of highest "
        "confidence; samples come in the order of their paths. Null for models that do not search for paths.",
    )
    shortfall: int = Field(description="n minus what was returned.")
    acceptance: float = Field(
        description="Share of the generated samples that reached the requested confidence."
    )
    seed: str = Field(description="The seed that was used, in decimal.", pattern="^[0-9]{1,20}$")
    timing_ms: TimingMs


class ContactInfo(BaseModel):
    """What is in the way of a configuration."""

    kind: Literal["known", "self", "seen", "hidden", "unread", "out of view"] = Field(
        description="A known body, a part of the robot, a surface that was seen; or unknown space: hidden "
        "behind a surface, without a reading, or out of view."
    )
    link: str = Field(description="The part of the robot, or the attached body.")
    other: str = Field(description="The body or part that it touches; empty for what pictures show.")
    position_m: list[float] = Field(description="Of the place on the robot, in its base frame.")
    depth_m: float = Field(description="How deep it is in; 0 in unknown space.")
    text: str = Field(description="In words.")

    @classmethod
    def of(cls, contact: Contact | None) -> Self | None:
        """As answers carry it."""
        return None if contact is None else cls.model_validate(contact, from_attributes=True)


class ValidityAnswer(SceneAnswer):
    """What a model predicts for configurations in a picture's scenario."""

    confidence: list[float] = Field(description="The validity head's probability that each one is free.")
    unseen: list[float] | None = Field(
        description="Share of the robot that would be where no picture shows what is there, of each one; "
        "null for worlds that are seen whole."
    )
    threshold: float | None = Field(
        description="The confidence that training recommends to ask for; null without one."
    )
    why: Annotated[list[ContactInfo | None] | None, LEFT_OUT] = Field(
        None,
        description="With `explain`: what is in the way of each configuration; null of those that pass.",
    )
    timing_ms: ScoreTimingMs


class BeliefAnswer(SceneAnswer):
    """What a model takes the scene to be, seen or not, on a grid of cells in the robot's base."""

    low_m: list[float] = Field(description="The grid's lowest corner, x, y and z.")
    cell_m: float = Field(description="Side of a cell.")
    counts: list[int] = Field(description="Cells along x, y and z.")
    occupied: str = Field(
        description="The probability in 1/255 that a ball of the cell's width in its middle touches "
        "something: base64 of a byte for each cell, z the fastest, x the slowest.",
        json_schema_extra={"contentEncoding": "base64"},
    )
    timing_ms: ScoreTimingMs


class Verdict(BaseModel):
    """Something that is wrong with the pictures, or may be."""

    code: str = Field(description="A name that never changes.")
    seen: str = Field(description="What was seen.")
    effect: str = Field(description="What it does to answers.")
    remedy: str = Field(description="What to do.")
    pictures: list[int] = Field(description="Numbers of the images that it is about, from 0; empty for all.")


class SuggestedPoseInfo(BaseModel):
    """Where a camera seems to stand instead of where it was said to."""

    picture: int = Field(description="Number of its image, from 0.")
    pose: list[list[float]] = Field(description="4 x 4, of the optical frame in the robot's base, m.")
    offset_m: float = Field(description="Its distance from the pose that was sent.")
    turn_deg: float = Field(description="How far it is turned from there.")


class DoctorTimingMs(BaseModel):
    """Where the time went, in ms."""

    diagnose: float
    novelty: float
    total: float


class DoctorAnswer(BaseModel):
    """What a close look at the pictures finds."""

    verdicts: list[Verdict] = Field(description="Empty where nothing wrong was found.")
    notes: list[str] = Field(description="What was seen and is not wrong, or could not be tested.")
    poses: list[SuggestedPoseInfo] = Field(description="Of cameras for which a better pose is clear.")
    scenario: ScenarioInfo
    model: ModelInfo
    timing_ms: DoctorTimingMs


class LeastSure(BaseModel):
    """Where the best path has its lowest confidence."""

    configuration: list[float] = Field(description="rad.")
    confidence: float = Field(description="Of this configuration alone.")
    unseen: float | None = Field(description="Share of the robot there that no picture shows.")
    along: float = Field(description="How far along the path, 0 to 1.")


class Alternative(BaseModel):
    """A path that was found."""

    path: list[list[float]]
    confidence: float
    edges: list[float]


class NextViewInfo(BaseModel):
    """A camera that would see more."""

    camera: dict[str, Any] = Field(description="As `view`.")
    sees: float = Field(description="Share of -log P(free) along the path that lies on space it would see.")


class PlanAnswer(SceneAnswer):
    """A path, or why there is none."""

    status: Literal["solved", "refused", "timeout"] = Field(
        description="`refused` where no path reaches the confidence or none was found, `timeout` where the "
        "time was over before one was."
    )
    reason: str | None = Field(description="Of what is not solved, in words.")
    path: list[list[float]] = Field(description="From start to goal, straight in between, rad; or empty.")
    confidence: float = Field(
        description="Of the whole path, an estimate: exp(-exp(a + b log D)) with D the integral of "
        "-log P(free) along it in rad and its largest value, and (a, b) the bundle's `plan_calibration` for "
        "this number of pictures; exp(-D) without one. Of the best path where it is refused; 0 without one."
    )
    receipt: Annotated[str | None, LEFT_OUT] = Field(
        None, description="To be sent back with the outcome. Left out where the server keeps no outcomes."
    )
    kept: Annotated[bool | None, LEFT_OUT] = Field(
        None, description="With `keep`: whether the server keeps pictures and path."
    )
    edges: list[float] = Field(description="The lowest confidence on each edge of the path.")
    unseen: list[float] | None = Field(
        description="The largest share of the robot on each edge that no picture shows; null for worlds "
        "that are seen whole."
    )
    length_rad: float
    ways: int = Field(description="Paths that were found.")
    least_sure: LeastSure | None
    contact: Annotated[ContactInfo | None, LEFT_OUT] = Field(
        None, description="What is in the way, of an answer without a path; with `explain` or known bodies."
    )
    alternatives: list[Alternative] | None = Field(
        description="All paths that reach the confidence, the best first; null where they were not requested."
    )
    next_view: NextViewInfo | None = Field(
        description="Of the best path; null where it was not requested, none would see more, or the world "
        "is seen whole."
    )
    seed: str = Field(description="The seed that was used, in decimal.", pattern="^[0-9]{1,20}$")
    timing_ms: PlanTimingMs


class ListedModel(BaseModel):
    """A model that a request can name."""

    reference: str = Field(description="What to write into `model`.")
    name: str
    version: int
    aliases: list[str]
    run_id: str | None
    digest: str
    loaded: bool = Field(description="Whether it is in memory.")
    default: bool = Field(description="Whether it answers requests that name no model.")
    robot: str | None = Field(
        description="Whose configurations are sampled: SHA-256 of the robot; null for versions of releases "
        "that did not tell, until they are loaded."
    )
    world: dict[str, Any] | None = Field(
        description="The robot, with the limits of its joints, and the camera; null as `robot` is, and where "
        "they are too long to be told."
    )
    joint_space: AnyJointSpace | None = Field(description="As in an answer; null as `world` is.")


class ModelList(BaseModel):
    """The models that requests can name."""

    default: str
    registry: Literal["none", "reachable", "unreachable"]
    models: list[ListedModel]


class Live(BaseModel):
    """The process answers."""

    status: Literal["live"] = "live"


class Ready(BaseModel):
    """Samples can be asked for."""

    status: Literal["ready"] = "ready"
    registry: Literal["none", "reachable", "unreachable"]
    successor: Literal["none", "pending", "refused"] = Field(
        description="Whether there is a champion that is not in service: being fetched, or refused."
    )
    model: ModelInfo


class Problem(BaseModel):
    """RFC 9457 problem details."""

    type: str
    title: str
    status: int
    detail: str
    expected: str | None = None
    got: str | None = None
    remedy: str | None = None
    errors: list[FieldProblem] | None = None
