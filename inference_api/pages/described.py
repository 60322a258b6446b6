"""What FastAPI cannot see of the pages for the OpenAPI document: bodies read by hand, ``.npy``, problems."""

from typing import Any

from pydantic import BaseModel

from inference_api.pages.planning.schemas import PlanAnswer, PlanRequest, plan_form_schema
from inference_api.pages.sampling import NPY
from inference_api.pages.schemas import SampleAnswer, SampleRequest, multipart_schema
from inference_api.pages.validity_schemas import ValidityAnswer, ValidityRequest, validity_form_schema
from inference_api.problems import (
    BODY_TOO_LARGE,
    FOREIGN_ORIGIN,
    HEADERS_TIMEOUT,
    HEADERS_TOO_LARGE,
    INTERNAL_ERROR,
    INVALID_IMAGE,
    INVALID_VALUE,
    MALFORMED_BODY,
    MALFORMED_REQUEST,
    MEDIA_TYPE,
    NO_MODEL,
    NO_PLANNER,
    OTHER_ROBOT,
    OUT_OF_RESOURCES,
    OVERLOADED,
    REGISTRY_UNAVAILABLE,
    REQUEST_TIMEOUT,
    SHUTTING_DOWN,
    STARTING,
    STORAGE_UNAVAILABLE,
    TOO_MANY_REQUESTS,
    UNAUTHORIZED,
    UNKNOWN_HOST,
    UNKNOWN_MODEL,
    UNSUPPORTED_MEDIA_TYPE,
    URI_TOO_LONG,
    ProblemType,
)

# What is answered before any page is looked for: by the guards, and by the protocol below them.
GUARD_PROBLEMS = (
    MALFORMED_REQUEST,
    UNAUTHORIZED,
    FOREIGN_ORIGIN,
    HEADERS_TIMEOUT,
    URI_TOO_LONG,
    UNKNOWN_HOST,
    TOO_MANY_REQUESTS,
    HEADERS_TOO_LARGE,
    OVERLOADED,
    SHUTTING_DOWN,
)
SAMPLE_PROBLEMS = (
    *GUARD_PROBLEMS,
    MALFORMED_BODY,
    UNKNOWN_MODEL,
    REQUEST_TIMEOUT,
    OTHER_ROBOT,
    BODY_TOO_LARGE,
    UNSUPPORTED_MEDIA_TYPE,
    INVALID_IMAGE,
    INVALID_VALUE,
    INTERNAL_ERROR,
    NO_MODEL,
    OUT_OF_RESOURCES,
    STORAGE_UNAVAILABLE,
    REGISTRY_UNAVAILABLE,
)
_HEADERS = {
    "X-Model-Name": "Name of the model that answered.",
    "X-Model-Version": "Its number in the registry, 0 for the shipped model.",
    "X-Model-Digest": "SHA-256 of the bundle's sums.",
    "X-Robot": "`robot` of the model.",
    "X-Alias-Confirmed": "`alias_confirmed` of the model, `true` or `false`.",
    "X-Seed": "The seed that was used, in decimal.",
    "X-Shortfall": "n minus what was returned.",
    "X-Acceptance": "Share of what was drawn that reached the confidence asked for.",
    "X-Joint-Space": "`joint_space` of the JSON answer, as JSON.",
    "X-Novelty": "How unlike the training scenarios the picture is, 0 to 1, where the model tells.",
    "X-Warnings": "`warnings` of the JSON answer, as JSON; of many the last ones have an empty message.",
    "Server-Timing": "decode, encode, generate and total, in ms.",
}


_OF_SAMPLES = {"X-Seed", "X-Shortfall", "X-Acceptance"}


def sample_extra() -> dict[str, Any]:
    """The request body of ``POST /sample`` in both forms."""
    return _body(multipart_schema(), SampleRequest)


def sample_responses() -> dict[int | str, dict[str, Any]]:
    """The answers of ``POST /sample``."""
    success = {
        "description": "Samples, as JSON or as `.npy`.",
        "model": SampleAnswer,
        "content": {NPY: _binary("float32 array (samples, joints)")},
        "headers": _headers(_HEADERS),
    }
    return {200: success, **problem_responses(*SAMPLE_PROBLEMS)}


def validity_extra() -> dict[str, Any]:
    """The request body of ``POST /validity`` in both forms."""
    return _body(validity_form_schema(), ValidityRequest)


def validity_responses() -> dict[int | str, dict[str, Any]]:
    """The answers of ``POST /validity``."""
    told = {name: text for name, text in _HEADERS.items() if name not in _OF_SAMPLES}
    told |= {
        "X-Threshold": "The confidence that training recommends, for models that have one.",
        "Server-Timing": "decode, encode, score and total, in ms.",
    }
    success = {
        "description": "A confidence for each configuration, as JSON or as `.npy`.",
        "model": ValidityAnswer,
        "content": {NPY: _binary("float32 array (configurations, 2): confidence and unseen, NaN for null")},
        "headers": _headers(told),
    }
    return {200: success, **problem_responses(*SAMPLE_PROBLEMS)}


def plan_extra() -> dict[str, Any]:
    """The request body of ``POST /plan`` in both forms."""
    return _body(plan_form_schema(), PlanRequest)


def plan_responses() -> dict[int | str, dict[str, Any]]:
    """The answers of ``POST /plan``."""
    success = {
        "description": "A way, or why there is none.",
        "model": PlanAnswer,
        "headers": _headers({}),
    }
    return {200: success, **problem_responses(*SAMPLE_PROBLEMS, NO_PLANNER, STARTING)}


def _body(form: dict[str, Any], asked: type[BaseModel]) -> dict[str, Any]:
    """A body that is a form, or JSON with the same names."""
    content = {
        "multipart/form-data": {"schema": form},
        "application/json": {"schema": asked.model_json_schema()},
    }
    return {"requestBody": {"required": True, "content": content}}


def _binary(text: str) -> dict[str, Any]:
    return {"schema": {"type": "string", "format": "binary", "description": text}}


def _headers(told: dict[str, str]) -> dict[str, Any]:
    headers = {
        name: {"description": f"{text} With `Accept: {NPY}` only.", "schema": {"type": "string"}}
        for name, text in told.items()
    }
    text = "The client's own, or one that the server chose; every answer carries it."
    return headers | {"X-Request-ID": {"description": text, "schema": {"type": "string"}}}


def problem_responses(*problems: ProblemType) -> dict[int | str, dict[str, Any]]:
    """Answers that are problems, one entry a status."""
    responses: dict[int | str, dict[str, Any]] = {}
    for status in dict.fromkeys(problem.status for problem in problems):
        same = [problem for problem in problems if problem.status == status]
        examples = {
            problem.name: {
                "value": {"type": problem.uri, "title": problem.title, "status": status, "detail": "..."}
            }
            for problem in same
        }
        schema = {"$ref": "#/components/schemas/Problem"}
        responses[status] = {
            "description": "; ".join(problem.title for problem in same) + ".",
            "content": {MEDIA_TYPE: {"schema": schema, "examples": examples}},
        }
    return responses
