"""RFC 9457 problem details: one stable type for each way in which a request can fail."""

import errno
import json
import logging
import re
import reprlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import Receive, Scope, Send

from cspace.errors import (
    CspaceError,
    ImageError,
    InputError,
    ModelNotFoundError,
    OtherRobotError,
    RegistryError,
    StorageError,
)

_LOG = logging.getLogger(__name__)
MEDIA_TYPE = "application/problem+json"
_PREFIX = "urn:cspace-sampler:problem:"


class ModelNotReadyError(CspaceError):
    """There is no model that could answer."""


class ProblemType(NamedTuple):
    """One row of the contract's table of errors: the ``type`` never changes once published."""

    name: str
    status: int
    title: str


MALFORMED_BODY = ProblemType("malformed-body", 400, "The body or its JSON is malformed")
UNAUTHORIZED = ProblemType("unauthorized", 401, "A key is needed")
FOREIGN_ORIGIN = ProblemType("foreign-origin", 403, "Another site's page may not use this server")
UNKNOWN_MODEL = ProblemType("unknown-model", 404, "No such model")
NOT_FOUND = ProblemType("not-found", 404, "No such page")
NO_OUTCOMES = ProblemType("no-outcomes", 404, "This server keeps no outcomes")
METHOD_NOT_ALLOWED = ProblemType("method-not-allowed", 405, "The page does not take this method")
REQUEST_TIMEOUT = ProblemType("request-timeout", 408, "The body did not arrive in time")
OTHER_ROBOT = ProblemType("other-robot", 409, "The model is of another robot")
BODY_TOO_LARGE = ProblemType("body-too-large", 413, "The body is too large")
UNSUPPORTED_MEDIA_TYPE = ProblemType("unsupported-media-type", 415, "The body's media type is not supported")
INVALID_IMAGE = ProblemType("invalid-image", 422, "The picture is not acceptable")
INVALID_VALUE = ProblemType("invalid-value", 422, "A field is wrong")
# nginx's number for it; nobody reads the answer, but metrics and log count it.
CLIENT_GONE = ProblemType("client-gone", 499, "The client went away")
INTERNAL_ERROR = ProblemType("internal-error", 500, "The server failed")
NO_PLANNER = ProblemType("no-planner", 501, "This server does not plan")
OVERLOADED = ProblemType("overloaded", 503, "The server answers too many requests already")
SHUTTING_DOWN = ProblemType("shutting-down", 503, "The server is shutting down")
STARTING = ProblemType("starting", 503, "The server is starting")
NO_MODEL = ProblemType("no-model", 503, "No model is ready")
STORAGE_UNAVAILABLE = ProblemType("storage-unavailable", 503, "The server cannot store the model")
OUT_OF_RESOURCES = ProblemType("out-of-resources", 503, "The server has no memory, threads or files left")
REGISTRY_UNAVAILABLE = ProblemType("registry-unavailable", 503, "The model registry does not answer")

PROBLEMS = tuple(value for value in list(globals().values()) if isinstance(value, ProblemType))
# What every route may answer, for the OpenAPI document.
PROBLEM_RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {
        "description": "A problem, by its `type`.",
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    for status in ("4XX", "5XX")
}
# All that a client is told of failures that are not about its request.
_ABOUT_THE_SERVER = {
    INTERNAL_ERROR: "the server failed; its log says how",
    STORAGE_UNAVAILABLE: "the server's disk is full, or its CSPACE_MODEL_CACHE cannot be written",
    OUT_OF_RESOURCES: "the server has no memory, threads or files left; ask again soon, or for less",
    REGISTRY_UNAVAILABLE: "the registry of models does not answer; ask again in some seconds",
}
_NOTHING_LEFT = {errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN}
# The interpreter and libraries in C++ have no type for it.
_SAYS_EXHAUSTED = re.compile(r"can't start new thread|allocat|bad_alloc|failed to map segment", re.IGNORECASE)
_BY_STATUS = {404: NOT_FOUND, 405: METHOD_NOT_ALLOWED, 413: BODY_TOO_LARGE, 415: UNSUPPORTED_MEDIA_TYPE}
# In this order: the first that fits decides.
_BY_ERROR: tuple[tuple[type[CspaceError], ProblemType], ...] = (
    (ImageError, INVALID_IMAGE),
    (OtherRobotError, OTHER_ROBOT),
    (InputError, INVALID_VALUE),
    (ModelNotFoundError, UNKNOWN_MODEL),
    (RegistryError, REGISTRY_UNAVAILABLE),
    (ModelNotReadyError, NO_MODEL),
    (StorageError, STORAGE_UNAVAILABLE),
)
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 100


class RequestError(CspaceError):
    """A request that is refused with a problem of its own; ``details`` are those of every CspaceError."""

    def __init__(
        self, problem: ProblemType, what: str, headers: Mapping[str, str] | None = None, **details: str | None
    ) -> None:
        super().__init__(what, **details)
        self.problem, self.headers = problem, headers


class ProblemResponse(Response):
    """A problem; members that are None are left out. Metrics and log find its name in the request's state."""

    media_type = MEDIA_TYPE

    def __init__(
        self, problem: ProblemType, detail: str, headers: Mapping[str, str] | None = None, **members: Any
    ) -> None:
        body = {"type": _PREFIX + problem.name, "title": problem.title, "status": problem.status}
        body |= {name: value for name, value in {"detail": detail, **members}.items() if value is not None}
        # ASCII, for a detail may echo half a surrogate pair, which UTF-8 does not have.
        super().__init__(json.dumps(body), problem.status, headers)
        self.problem = problem

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope.setdefault("state", {})["problem"] = self.problem.name
        await super().__call__(scope, receive, send)


def overloaded(what: str) -> RequestError:
    """The error of a server or client that has too much under way; it says when to ask again."""
    remedy = "ask again after 1 s, for less or from fewer places at once"
    return RequestError(OVERLOADED, what, headers={"Retry-After": "1"}, remedy=remedy)


def problem_of(error: BaseException) -> ProblemType:
    """The problem type under which an error is reported."""
    if isinstance(error, RequestError):
        return error.problem
    if _is_exhausted(error):
        return OUT_OF_RESOURCES
    return next((problem for kind, problem in _BY_ERROR if isinstance(error, kind)), INTERNAL_ERROR)


def _is_exhausted(error: BaseException) -> bool:
    """Whether an error, or one that it was raised from, says that nothing is left of the machine."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _NOTHING_LEFT):
        return True
    # Messages of this project and of validators may quote a client.
    if not isinstance(error, CspaceError | ValueError) and _SAYS_EXHAUSTED.search(str(error)):
        return True
    return error.__cause__ is not None and _is_exhausted(error.__cause__)


def problem_response(error: Exception) -> ProblemResponse:
    """What a client is told of an error; words about the server itself are for the log alone."""
    problem = problem_of(error)
    if problem in _ABOUT_THE_SERVER:
        level = logging.ERROR if problem is INTERNAL_ERROR else logging.WARNING
        is_own = isinstance(error, CspaceError)
        _LOG.log(level, "a request failed: %s", error, exc_info=None if is_own else error)
        return ProblemResponse(problem, _ABOUT_THE_SERVER[problem])
    headers = error.headers if isinstance(error, RequestError) else None
    members = {name: getattr(error, name, None) for name in ("expected", "got", "remedy")}
    return ProblemResponse(problem, str(error), headers, **members)


def invalid_fields(errors: Sequence[Any]) -> ProblemResponse:
    """The answer to pydantic's errors, of a body or of a query."""
    found = [_field(one) for one in errors]
    first = found[0]
    detail = f"{first['field']} is wrong; expected {first['expected']}; got {first['got']}"
    return ProblemResponse(INVALID_VALUE, detail, expected=first["expected"], got=first["got"], errors=found)


def _field(error: Mapping[str, Any]) -> dict[str, str]:
    place = [str(part) for part in error["loc"]]
    field = ".".join(place[1:] if place[:1] in (["body"], ["query"]) else place) or "the body"
    if error["type"] == "missing":
        return {"field": field, "expected": "a value", "got": "nothing"}
    expected = error["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return {"field": field, "expected": expected, "got": shown(error["input"])}


def shown(value: object) -> str:
    """A short text of an untrusted value, however deep or long it is."""
    return _SHORT.repr(value)[:200]


def add_problem_handlers(app: FastAPI) -> None:
    """Answers every error of the app's routes with a problem; telemetry answers those that nobody foresaw."""

    @app.exception_handler(CspaceError)
    async def project_error(_: Request, error: CspaceError) -> Response:
        return problem_response(error)

    @app.exception_handler(RequestValidationError)
    @app.exception_handler(ValidationError)
    async def invalid(_: Request, error: RequestValidationError | ValidationError) -> Response:
        return invalid_fields(error.errors())

    @app.exception_handler(HTTPException)
    async def http_error(_: Request, error: HTTPException) -> Response:
        fallback = MALFORMED_BODY if error.status_code < 500 else INTERNAL_ERROR
        problem = _BY_STATUS.get(error.status_code, fallback)
        return ProblemResponse(problem, str(error.detail), error.headers)

    @app.exception_handler(ClientDisconnect)
    async def gone(_: Request, __: ClientDisconnect) -> Response:
        return ProblemResponse(CLIENT_GONE, "the client went away before its answer")
