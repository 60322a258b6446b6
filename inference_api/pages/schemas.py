"""Requests and answers of the API as types; the OpenAPI document is made from them."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, WithJsonSchema

from cspace.query import DIGEST_PATTERN, MAX_EPSILON, MAX_SAMPLES, MAX_SEED, PLAIN, SampleQuery, drawn_seed
from cspace.view_file import MAX_PICTURES
from cspace.world import Finding
from inference_api.failures import FieldProblem
from inference_api.pages.model_schemas import AnyJointSpace, ModelInfo
from inference_api.pages.picture_fields import (
    CAMERA_TOLD,
    PICTURE_EXPECTED,
    SCALE_TOLD,
    STATE_TOLD,
    Cameras,
    Configuration,
    PictureFiles,
    Scale,
    picture_of,
)

MAX_EPSILONS = 1000

_SEED = re.compile(r"[0-9]{1,20}", re.ASCII)


def _parse_seed(value: object) -> object:
    return int(value) if isinstance(value, str) and _SEED.fullmatch(value) else value


def _as_list(value: object) -> object:
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


def _without_default(schema: dict[str, Any]) -> None:
    schema.pop("default", None)


# What is absent stands for the server's own, which no schema knows.
DEFAULT_NAME = ""
ModelName = Annotated[str, Field(max_length=300, json_schema_extra=_without_default)]
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
_Epsilon = Annotated[float, Field(ge=0.0, le=MAX_EPSILON, allow_inf_nan=False)]
_EpsilonSchema = {"type": "number", "minimum": 0, "maximum": MAX_EPSILON}
_Schedule = Annotated[
    Annotated[tuple[_Epsilon, ...], Field(min_length=1, max_length=MAX_EPSILONS), Strict(strict=False)],
    BeforeValidator(_as_list),
    WithJsonSchema(
        {
            "anyOf": [
                _EpsilonSchema,
                {"type": "array", "items": _EpsilonSchema, "minItems": 1, "maxItems": MAX_EPSILONS},
            ]
        }
    ),
]
_Confidence = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] | None


# In this order fields are described, and those that are wrong are told.
EXPECTED = {
    **PICTURE_EXPECTED,
    "n": f"a whole number from 1 to {MAX_SAMPLES}",
    "model": "name, name@alias, name/version or pretrained",
    "seed": "an unsigned 64-bit whole number, or its decimal digits as text",
    "epsilon_sigma": "one or more finite numbers from 0 to 10",
    "start": "an array of finite angles in rad",
    "goal": "an array of finite angles in rad",
    "min_confidence": "a finite number from 0 to 1",
    "robot": "64 hexadecimal digits, small letters",
}


def _in_order(schema: dict[str, Any]) -> None:
    schema["properties"] = {name: schema["properties"][name] for name in EXPECTED}


class RequestFields(BaseModel):
    """Fields of a request; unknown ones are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    EXPECTED: ClassVar[Mapping[str, str]] = EXPECTED


class SceneFields(RequestFields):
    """Fields that show the scene."""

    image: PictureFiles = Field(
        description="The scenario as a square PNG of 16 to 2048 pixels: RGB as it is, RGBA over white, grey "
        "and palette as RGB; 16-bit and animated ones are refused. Resized by area averaging. For models of "
        f"depth cameras, 1 to {MAX_PICTURES} 16-bit grey PNGs of mm along the optical axis, 0 for no "
        "reading, and what is below 20 mm or beyond 10 m as well."
    )
    camera: Cameras = Field((), description=CAMERA_TOLD)
    state: Configuration | None = Field(None, description=STATE_TOLD)
    depth_scale_m: Scale | None = Field(None, description=SCALE_TOLD)

    def picture(self) -> bytes:
        """See :func:`inference_api.pages.picture_fields.picture_of`."""
        return picture_of(self.image, self.camera, self.state, self.depth_scale_m)


class QueryFields(RequestFields):
    """What is asked for one picture, whatever names the picture and the model; unknown fields are errors."""

    n: int = Field(300, ge=1, le=MAX_SAMPLES, description="How many samples.")
    seed: Seed = Field(
        None,
        description="Unsigned 64 bit as number or decimal string; drawn and returned when absent. "
        "The samples for a smaller n are not promised to be a prefix.",
    )
    epsilon_sigma: _Schedule = Field(
        PLAIN,
        description="The encoder's standard deviation is raised by each value; equal shares of the samples "
        "in this order, the remainder to the first.",
    )
    start: Configuration | None = Field(
        None,
        description="Configuration in rad, for path models and only for them: circles are wrapped, other "
        "joints have to lie within their limits.",
    )
    goal: Configuration | None = Field(None, description="As `start`.")
    min_confidence: _Confidence = Field(
        None,
        description="What the model's validity head has to score; more are drawn for those that do not. "
        "Absent, the model's own threshold holds; 0 takes all; above 0 only for models that have a head.",
    )

    robot: Annotated[str, Field(pattern=f"^{DIGEST_PATTERN}$")] | None = Field(
        None,
        description="The robot that is planned for, as `model.robot` of an answer has it: a model of another "
        "one refuses with 409. Absent, whichever robot the model is of.",
    )

    def query(self) -> SampleQuery:
        """The fields, which are judged here, as the value that travels on; draws a seed that is absent."""
        asked = {item.name: getattr(self, item.name) for item in fields(SampleQuery)}
        return SampleQuery(**asked | {"seed": drawn_seed(self.seed)})


class SampleRequest(QueryFields, SceneFields):
    """A request for samples; unknown fields are errors."""

    model_config = ConfigDict(json_schema_extra=_in_order)

    model: ModelName = Field(
        DEFAULT_NAME,
        description="`name` (its champion), `name@alias`, `name/version`, or `pretrained` (shipped). Absent, "
        "the champion of the model that the server was set up for.",
    )


class ScenarioInfo(BaseModel):
    """What the model makes of the picture."""

    novelty: float | None = Field(
        description="How unlike the training scenarios it is: the share of known pictures that are less "
        "unusual, 0 to 1; null for a model that does not tell."
    )


class PictureWarning(BaseModel):
    """Something about the pictures that makes the answer worse or wrong."""

    code: str = Field(description="A name that never changes.")
    message: str = Field(description="What was seen, what it does to the answer, and what to do.")
    pictures: list[int] = Field(description="Numbers of the images that it is about, from 0; empty for all.")


Warnings = Annotated[
    list[PictureWarning],
    Field(description="What is wrong, or may be, with the pictures; empty where nothing was found."),
]


def warnings_of(findings: Iterable[Finding]) -> list[PictureWarning]:
    """Findings as answers carry them, each code once."""
    once = {one.code: one for one in findings}
    return [
        PictureWarning(code=one.code, message=one.message, pictures=list(one.pictures))
        for one in once.values()
    ]


class TimingMs(BaseModel):
    """Where the time went, in ms."""

    decode: float
    encode: float
    generate: float
    total: float


class SampleAnswer(BaseModel):
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
        description="The way from start to goal that each sample lies along, 0 for the one that is doubted "
        "least; samples come in the order of their ways. Null for models that do not search for ways.",
    )
    shortfall: int = Field(description="n minus what was returned.")
    acceptance: float = Field(description="Share of what was drawn that reached the confidence asked for.")
    scenario: ScenarioInfo
    warnings: Warnings
    joint_space: AnyJointSpace
    model: ModelInfo
    seed: str = Field(description="The seed that was used, in decimal.", pattern="^[0-9]{1,20}$")
    timing_ms: TimingMs


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


def picture_form(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The schemas of images and cameras in a multipart form, of those in JSON."""
    description = f"{fields['image']['description']} Repeat the field for several."
    file = {"type": "string", "format": "binary"}
    many = {"type": "array", "items": file, "minItems": 1, "maxItems": MAX_PICTURES}
    camera = fields["camera"]
    told = f"{camera['description']} As JSON; repeat the field for several."
    return {
        "image": {"anyOf": [file, many], "description": description},
        "camera": camera | {"description": told},
    }


def multipart_schema() -> dict[str, Any]:
    """The JSON schema of the multipart form of :class:`SampleRequest`."""
    schema = SampleRequest.model_json_schema()
    fields = schema["properties"]
    fields |= picture_form(fields)
    schedule = fields["epsilon_sigma"]
    fields["epsilon_sigma"] = {
        "type": "array",
        "items": dict(_EpsilonSchema),
        "maxItems": MAX_EPSILONS,
        "description": f"{schedule['description']} Repeat the field for several values.",
    }
    return schema
