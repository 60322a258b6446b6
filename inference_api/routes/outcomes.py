"""``POST /outcomes``: what became of earlier answers, kept until it is uploaded."""

from functools import partial
from typing import Annotated, ClassVar, Literal

from fastapi import APIRouter, Request
from fastapi.responses import Response
from pydantic import BaseModel, Field, Strict, ValidationInfo, field_validator

from cspace.errors import InputError
from cspace.query import MAX_SAMPLES
from inference_api.limits import client_of
from inference_api.logs import REQUEST_ID, request_record
from inference_api.problem_types import (
    BODY_TOO_LARGE,
    GUARD_PROBLEMS,
    INTERNAL_ERROR,
    INVALID_VALUE,
    MALFORMED_BODY,
    NO_OUTCOMES,
    OUT_OF_RESOURCES,
    REQUEST_TIMEOUT,
    UNSUPPORTED_MEDIA_TYPE,
    FieldProblem,
    RequestError,
)
from inference_api.requests import Service, Serving, load_object, problem_responses, read_body
from inference_api.routes.sample import REQUEST_ID_HEADER
from inference_api.scheduler import Job, rows_of
from inference_api.schemas import Confidence, Expected, RequestFields, Site
from services.outcomes import matched

MAX_OUTCOMES = 1000
_Seconds = Annotated[
    Annotated[float, Field(ge=0.0, le=1e10, allow_inf_nan=False)] | None,
    Expected("seconds, not negative, or null"),
]
_Flag = Annotated[bool | None, Expected("true, false or null")]
_Count = Annotated[int, Field(ge=0, le=MAX_SAMPLES)]


class _OutcomeFields(RequestFields):
    """What both kinds of outcome have."""

    request_id: Annotated[
        str,
        Field(pattern=f"^{REQUEST_ID.pattern}$"),
        Expected("the X-Request-ID of the answer: 1 to 128 letters, digits, dots, dashes and underscores"),
    ] = Field(description="The `X-Request-ID` of the answer that this is about.")
    model: Annotated[
        str,
        Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}/[0-9]{1,9}$"),
        Expected("name/version, as the answer has them"),
    ] = Field(description="The model that answered, as `name/version`.")
    stamp_s: _Seconds = Field(
        None, description="When this outcome was known, in seconds since 1970-01-01 UTC."
    )
    confidence: Confidence = Field(None, description="That the answer stated; null where it stated none.")
    novelty: Confidence = Field(None, description="That the answer stated; null where it stated none.")
    receipt: Annotated[str | None, Expected("the receipt of the answer, or null")] = Field(
        None, max_length=1000, description="That the answer of `POST /plan` has; no plan counts without it."
    )
    site: Site = Field(None, description="A short name of the place, such as a cell's.")


class PlanOutcome(_OutcomeFields):
    """What became of an answer of `POST /plan`."""

    kind: Literal["plan"]
    success: Annotated[bool, Expected("true or false")] = Field(
        description="Whether the answer served its purpose: its path was free, or was executed to its end."
    )
    executed: _Flag = Field(None, description="Whether a robot moved along the path.")
    collided: _Flag = Field(
        None, description="Whether the path collides, in the world or for an exact check; null if not known."
    )
    collided_at: Annotated[
        Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] | None,
        Expected("a share from 0 to 1 of the path's length where collided is true, else null"),
    ] = Field(None, description="Where it collides first: the share of the path's length from its start.")
    time_s: _Seconds = Field(None, description="From the request to this outcome.")

    @field_validator("collided_at")
    @classmethod
    def _only_of_collisions(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("collided", True) is not True:
            raise ValueError("the path does not collide")
        return value


class SamplesOutcome(_OutcomeFields):
    """What became of an answer of `POST /sample`."""

    kind: Literal["samples"]
    checked: Annotated[_Count, Expected(f"a whole number from 0 to {MAX_SAMPLES}")] = Field(
        description="How many of the samples were checked exactly."
    )
    free: Annotated[_Count, Expected("a whole number from 0 to checked")] = Field(
        description="How many of those were free."
    )

    @field_validator("free")
    @classmethod
    def _of_those_checked(cls, value: int, info: ValidationInfo) -> int:
        if value > info.data.get("checked", MAX_SAMPLES):
            raise ValueError("more than were checked")
        return value


class OutcomesRequest(RequestFields):
    """A batch of outcomes."""

    KINDS: ClassVar[dict[str, type[RequestFields]]] = {"plan": PlanOutcome, "samples": SamplesOutcome}

    outcomes: Annotated[
        list[Annotated[PlanOutcome | SamplesOutcome, Field(discriminator="kind")]],
        Field(min_length=1, max_length=MAX_OUTCOMES),
        Strict(strict=False),
        Expected(f"1 to {MAX_OUTCOMES} objects"),
    ]

    @classmethod
    def problem_at(cls, kind: str, location: tuple[int | str, ...], value: object) -> FieldProblem:
        """Names the outcome and its field, not the list alone."""
        found = super().problem_at(kind, location, value)
        if len(location) < 2:
            return found
        place = f"{location[0]}[{location[1]}]"
        if len(location) < 4:
            words = "an object whose kind is plan or samples"
            return found.model_copy(update={"field": place, "expected": words})
        inner = cls.KINDS[str(location[2])].problem_at(kind, location[3:], value)
        return inner.model_copy(update={"field": f"{place}.{inner.field}"})


class OutcomesAnswer(BaseModel):
    """What was done with a batch."""

    kept: int = Field(
        description="Outcomes that were taken: those that match an answer, or 0 if the disk does not keep up."
    )


router = APIRouter()
_SCHEMA = {"$ref": "#/components/schemas/OutcomesRequest"}


@router.post(
    "/outcomes",
    status_code=202,
    summary="Report what became of earlier answers",
    openapi_extra={"requestBody": {"required": True, "content": {"application/json": {"schema": _SCHEMA}}}},
    responses={
        202: {
            "description": "They are on disk.",
            "model": OutcomesAnswer,
            "headers": REQUEST_ID_HEADER,
        },
        **problem_responses(
            *GUARD_PROBLEMS,
            MALFORMED_BODY,
            NO_OUTCOMES,
            REQUEST_TIMEOUT,
            BODY_TOO_LARGE,
            UNSUPPORTED_MEDIA_TYPE,
            INVALID_VALUE,
            INTERNAL_ERROR,
            OUT_OF_RESOURCES,
        ),
    },
)
async def outcomes(request: Request, service: Serving) -> Response:
    """Keeps the outcomes in a bounded folder of the server. An outcome that is sent twice counts once."""
    if service.spool is None:
        raise no_outcomes()
    text = (await read_body(request)).text
    if text is None:
        raise RequestError(
            UNSUPPORTED_MEDIA_TYPE, "outcomes come as JSON", expected="application/json", got="a form"
        )
    work = partial(_keep, service, text)
    return await service.scheduler.run(work, client_of(request.scope))


def no_outcomes() -> RequestError:
    """Of a server without a folder."""
    return RequestError(
        NO_OUTCOMES,
        "this server keeps no outcomes",
        remedy="set CSPACE_OUTCOMES to a folder where the server runs",
    )


def _keep(service: Service, text: bytes, job: Job) -> Response:
    job.spend(rows_of(json_bytes=len(text)))
    found = OutcomesRequest.read(load_object(text)).outcomes
    record, spool, receipts = request_record.get(), service.spool, service.receipts
    if spool is None or receipts is None:
        raise no_outcomes()
    reports = [one.model_dump(exclude_none=True) for one in found]
    rows = matched(reports, receipts, record.client if record else None)
    if not rows:
        raise InputError(
            "outcomes match no answer",
            expected="receipt, as the answer of POST /plan to the same client has it",
            got="none of this server",
        )
    body = OutcomesAnswer(kept=len(rows) if spool.add(rows) else 0)
    return Response(body.model_dump_json(), 202, media_type="application/json")
