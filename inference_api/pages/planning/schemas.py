"""Question and answer of ``POST /plan`` as types; the OpenAPI document is made from them."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, Field

from cspace.query import DEFAULT_WAYS, DIGEST_PATTERN, drawn_seed
from inference_api.pages.model_schemas import AnyJointSpace, ModelInfo
from inference_api.pages.picture_fields import MAX_VIEWS, PICTURE_EXPECTED, Configuration, Views
from inference_api.pages.schemas import (
    DEFAULT_NAME,
    EXPECTED,
    ModelName,
    ScenarioInfo,
    SceneFields,
    Seed,
    Warnings,
    picture_form,
)

MAX_TIME_S, MAX_WAYS = 10.0, 64
LEAST_TIME_S = 0.01
PLAN_EXPECTED = {
    **PICTURE_EXPECTED,
    **{name: EXPECTED[name] for name in ("start", "goal", "model", "seed", "min_confidence")},
    "time_limit_s": f"a finite number from {LEAST_TIME_S:g} to {MAX_TIME_S:g}",
    "ways": f"a whole number from 1 to {MAX_WAYS}",
    "alternatives": "true or false",
    "next_view": "true or false",
    "view": f"at most {MAX_VIEWS} objects of fx, fy, cx, cy, width, height and pose",
    "robot": EXPECTED["robot"],
}


class PlanRequest(SceneFields):
    """A question for a way; unknown fields are errors."""

    EXPECTED: ClassVar[Mapping[str, str]] = PLAN_EXPECTED

    start: Configuration = Field(
        description="Where the way begins, rad: circles at any turn, other joints within their limits."
    )
    goal: Configuration = Field(description="Where it ends, as `start`.")
    model: ModelName = Field(DEFAULT_NAME, description="As of `POST /sample`.")
    seed: Seed = Field(None, description="As of `POST /sample`: of all draws of the search.")
    min_confidence: Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] | None = Field(
        None,
        description="Below it no way is returned, but the reason why. Absent, 0.2 where plans of the model "
        "are calibrated, else 0.",
    )
    time_limit_s: Annotated[float, Field(ge=LEAST_TIME_S, le=MAX_TIME_S, allow_inf_nan=False)] = Field(
        1.0, description="Of the search; what is found by then is what is chosen from."
    )
    ways: int = Field(
        DEFAULT_WAYS, ge=1, le=MAX_WAYS, description="That are looked for, to choose the surest of."
    )
    alternatives: bool = Field(
        default=False,
        description="Whether the answer holds all ways that are sure enough, for those who can check them.",
    )
    next_view: bool = Field(
        default=False,
        description="Whether the answer names the camera that would see most of what the way is doubted for.",
    )
    view: Views = Field(
        (),
        description="Cameras to choose it from, as `camera` with `width` and `height` in pixels; in a form "
        "repeat the field. Absent, some about the doubt, from where cameras of the training stood. Those go "
        "first that look from elsewhere than `camera`, by 45 degrees.",
    )
    robot: Annotated[str, Field(pattern=f"^{DIGEST_PATTERN}$")] | None = Field(
        None, description="As of `POST /sample`."
    )

    def drawn_seed(self) -> int:
        """The seed, drawn where it is absent."""
        return drawn_seed(self.seed)


class LeastSure(BaseModel):
    """Where the surest way is least sure."""

    configuration: list[float] = Field(description="rad.")
    confidence: float = Field(description="Of this configuration alone.")
    unseen: float | None = Field(description="Share of the robot there that no picture shows.")
    along: float = Field(description="How far along the way, 0 to 1.")


class Alternative(BaseModel):
    """A way that was found."""

    path: list[list[float]]
    confidence: float
    edges: list[float]


class NextViewInfo(BaseModel):
    """A camera that would see more."""

    camera: dict[str, Any] = Field(description="As `view`.")
    sees: float = Field(description="Share of the doubt along the way that lies on space it would see.")


class PlanTimingMs(BaseModel):
    """Where the time went, in ms."""

    decode: float
    encode: float
    search: float
    score: float
    total: float


class PlanAnswer(BaseModel):
    """A way, or why there is none."""

    status: Literal["solved", "refused", "timeout"] = Field(
        description="`refused` where no way is sure enough or none was found, `timeout` where the time was "
        "over before one was."
    )
    reason: str | None = Field(description="Of what is not solved, in words.")
    path: list[list[float]] = Field(description="From start to goal, straight in between, rad; or empty.")
    confidence: float = Field(
        description="Of the whole way, an estimate: exp(-exp(a + b log D)) with D the integral of "
        "-log P(free) along it in rad and its largest value, and (a, b) the bundle's `plan_doubt`; exp(-D) "
        "without one. Of the surest way where it is refused; 0 without one."
    )
    edges: list[float] = Field(description="The least confidence on each piece of the way.")
    unseen: list[float] | None = Field(
        description="The largest share of the robot on each piece that no picture shows; null for worlds "
        "that are seen whole."
    )
    length_rad: float
    ways: int = Field(description="That were found.")
    least_sure: LeastSure | None
    alternatives: list[Alternative] | None = Field(
        description="All ways that are sure enough, the surest first; null where they were not asked for."
    )
    next_view: NextViewInfo | None = Field(
        description="Of the surest way; null where it was not asked for, none would see more, or the world "
        "is seen whole."
    )
    seed: str = Field(description="The seed that was used, in decimal.", pattern="^[0-9]{1,20}$")
    scenario: ScenarioInfo
    warnings: Warnings
    joint_space: AnyJointSpace
    model: ModelInfo
    timing_ms: PlanTimingMs


def plan_form_schema() -> dict[str, Any]:
    """The JSON schema of the multipart form of :class:`PlanRequest`."""
    schema = PlanRequest.model_json_schema()
    schema["properties"] = schema["properties"] | picture_form(schema["properties"])
    return schema
