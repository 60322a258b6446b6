"""Question and answer of ``POST /validity`` as types; the OpenAPI document is made from them."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, Field, Strict, WithJsonSchema

from cspace.query import DIGEST_PATTERN, MAX_SAMPLES
from inference_api.pages.model_schemas import AnyJointSpace, ModelInfo
from inference_api.pages.picture_fields import MAX_JOINTS, PICTURE_EXPECTED, Angle
from inference_api.pages.schemas import (
    DEFAULT_NAME,
    EXPECTED,
    ModelName,
    ScenarioInfo,
    SceneFields,
    Warnings,
    picture_form,
)

VALIDITY_EXPECTED = {
    **PICTURE_EXPECTED,
    "configurations": f"1 to {MAX_SAMPLES} arrays of finite angles in rad: JSON, or a .npy file in a form",
    "model": EXPECTED["model"],
    "robot": EXPECTED["robot"],
}

_Row = Annotated[tuple[Angle, ...], Field(min_length=1, max_length=MAX_JOINTS), Strict(strict=False)]
_Configurations = Annotated[
    bytes | Annotated[tuple[_Row, ...], Field(min_length=1, max_length=MAX_SAMPLES), Strict(strict=False)],
    WithJsonSchema(
        {
            "type": "array",
            "items": {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": MAX_JOINTS},
            "minItems": 1,
            "maxItems": MAX_SAMPLES,
        }
    ),
]


class ValidityRequest(SceneFields):
    """A question whether configurations are free; unknown fields are errors."""

    EXPECTED: ClassVar[Mapping[str, str]] = VALIDITY_EXPECTED

    configurations: _Configurations = Field(
        description=f"1 to {MAX_SAMPLES} configurations in rad, circles at any turn, other joints within "
        "their limits. In JSON, or in a form as a `.npy` file: float32 or float64 of shape (n, joints)."
    )
    model: ModelName = Field(DEFAULT_NAME, description="As of `POST /sample`.")
    robot: Annotated[str, Field(pattern=f"^{DIGEST_PATTERN}$")] | None = Field(
        None, description="As of `POST /sample`."
    )


class ScoreTimingMs(BaseModel):
    """Where the time went, in ms."""

    decode: float
    encode: float
    score: float
    total: float


class ValidityAnswer(BaseModel):
    """What a model holds of configurations in a picture's scenario."""

    confidence: list[float] = Field(description="The validity head's probability that each one is free.")
    unseen: list[float] | None = Field(
        description="Share of the robot that would be where no picture shows what is there, of each one; "
        "null for worlds that are seen whole."
    )
    threshold: float | None = Field(
        description="The confidence that training recommends to ask for; null without one."
    )
    scenario: ScenarioInfo
    warnings: Warnings
    joint_space: AnyJointSpace
    model: ModelInfo
    timing_ms: ScoreTimingMs


def validity_form_schema() -> dict[str, Any]:
    """The JSON schema of the multipart form of :class:`ValidityRequest`."""
    schema = ValidityRequest.model_json_schema()
    fields = schema["properties"]
    description = fields["configurations"]["description"]
    file = {"type": "string", "format": "binary", "description": description}
    schema["properties"] = fields | picture_form(fields) | {"configurations": file}
    return schema
