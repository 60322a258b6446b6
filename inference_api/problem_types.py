"""RFC 9457 problem details: one stable type for each way in which a request can fail."""

import errno
import http
import json
import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

from fastapi import FastAPI, Request
from fastapi.responses import Response
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from cspace.errors import (
    CspaceError,
    ImageError,
    InputError,
    ModelNotFoundError,
    OtherRobotError,
    RegistryError,
    StorageError,
)
from inference_api.logs import request_record

_LOG = logging.getLogger(__name__)
MEDIA_TYPE = "application/problem+json"
# Below it an error is the Open Inference Protocol's, which knows one status for a request that is wrong.
V2 = "/v2"
_V2_STATUS = {422: 400}
_PREFIX = "urn:cspace-sampler:problem:"


class FieldProblem(BaseModel):
    """What is wrong with one field."""

    field: str
    expected: str
    got: str


class FieldsError(InputError):
    """One or more fields are wrong.

    Args:
        problems: one entry a field.
    """

    def __init__(self, problems: list[FieldProblem]) -> None:
        first = problems[0]
        super().__init__(f"{first.field} is wrong", expected=first.expected, got=first.got)
        self.problems = problems


class NoKernelsError(CspaceError):
    """What is asked for needs compiled code that this server has not."""


class ModelNotReadyError(CspaceError):
    """There is no model that could answer."""


@dataclass(frozen=True, slots=True)
class ProblemType:
    """One row of the contract's table of errors.

    Args:
        name: last part of the ``type`` URI, never changed once published.
        status: HTTP status.
        title: the same for every occurrence.
    """

    name: str
    status: int
    title: str

    @property
    def uri(self) -> str:
        """The problem's ``type``."""
        return _PREFIX + self.name


MALFORMED_REQUEST = ProblemType("malformed-request", 400, "This is no HTTP request")
MALFORMED_BODY = ProblemType("malformed-body", 400, "The body or its JSON is malformed")
UNAUTHORIZED = ProblemType("unauthorized", 401, "A key is needed")
FOREIGN_ORIGIN = ProblemType("foreign-origin", 403, "Another site's page may not use this server")
UNKNOWN_MODEL = ProblemType("unknown-model", 404, "No such model")
NOT_FOUND = ProblemType("not-found", 404, "No such page")
NO_OUTCOMES = ProblemType("no-outcomes", 404, "This server keeps no outcomes")
METHOD_NOT_ALLOWED = ProblemType("method-not-allowed", 405, "The page does not take this method")
REQUEST_TIMEOUT = ProblemType("request-timeout", 408, "The body did not arrive in time")
HEADERS_TIMEOUT = ProblemType("headers-timeout", 408, "The headers did not arrive in time")
OTHER_ROBOT = ProblemType("other-robot", 409, "The model is of another robot")
BODY_TOO_LARGE = ProblemType("body-too-large", 413, "The body is too large")
URI_TOO_LONG = ProblemType("uri-too-long", 414, "The path is too long")
UNSUPPORTED_MEDIA_TYPE = ProblemType("unsupported-media-type", 415, "The body's media type is not supported")
UNKNOWN_HOST = ProblemType("unknown-host", 421, "The server does not answer under this name")
INVALID_IMAGE = ProblemType("invalid-image", 422, "The picture is not acceptable")
INVALID_VALUE = ProblemType("invalid-value", 422, "A field is wrong")
TOO_MANY_REQUESTS = ProblemType("too-many-requests", 429, "The client asks too often")
HEADERS_TOO_LARGE = ProblemType("headers-too-large", 431, "The headers are too large")
# nginx's number for it; nobody reads the answer, but metrics and log tell of it.
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
# What is answered before any route is looked for: by the limits, and by the protocol below them.
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
# What a route that computes something for a picture answers.
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
# All that a client is told of failures that are not about its request.
_ABOUT_THE_SERVER = {
    INTERNAL_ERROR: "the server failed; its log says how",
    STORAGE_UNAVAILABLE: "the model that was asked for cannot be stored: the server's disk is full, or its "
    "CSPACE_MODEL_CACHE cannot be written or is in use; its log says which",
    OUT_OF_RESOURCES: "the server has no memory, threads or open files left for this request; ask again in "
    "some seconds, or for less",
    REGISTRY_UNAVAILABLE: "the model that was asked for is not here, and the model registry does not answer; "
    "ask again in some seconds",
}
_SHOWN_BITS = 128
_NOTHING_LEFT = {errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN}
_SAYS_EXHAUSTED = re.compile(r"can't start new thread|allocat|bad_alloc|failed to map segment", re.IGNORECASE)
_BY_STATUS = {404: NOT_FOUND, 405: METHOD_NOT_ALLOWED, 413: BODY_TOO_LARGE, 415: UNSUPPORTED_MEDIA_TYPE}
# In this order: the first that fits decides.
_BY_ERROR: tuple[tuple[type[CspaceError], ProblemType], ...] = (
    (ImageError, INVALID_IMAGE),
    (OtherRobotError, OTHER_ROBOT),
    (NoKernelsError, NO_PLANNER),
    (InputError, INVALID_VALUE),
    (ModelNotFoundError, UNKNOWN_MODEL),
    (RegistryError, REGISTRY_UNAVAILABLE),
    (ModelNotReadyError, NO_MODEL),
    (StorageError, STORAGE_UNAVAILABLE),
)


class RequestError(CspaceError):
    """A request that is refused with a problem of its own.

    Args:
        problem: which way.
        what: as :class:`cspace.errors.CspaceError`, and so the rest.
        headers: of the answer.
    """

    def __init__(
        self,
        problem: ProblemType,
        what: str,
        *,
        headers: Mapping[str, str] | None = None,
        **details: str | None,
    ) -> None:
        super().__init__(what, **details)
        self.problem, self.headers = problem, headers


def problem_of(error: BaseException) -> ProblemType:
    """The problem type under which an error is reported."""
    if isinstance(error, RequestError):
        return error.problem
    if _is_exhausted(error):
        return OUT_OF_RESOURCES
    return next((problem for kind, problem in _BY_ERROR if isinstance(error, kind)), INTERNAL_ERROR)


def _is_exhausted(error: BaseException) -> bool:
    """Whether an error, or one that it was raised from, says that nothing is left of the machine."""
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError) and error.errno in _NOTHING_LEFT:
        return True
    # The interpreter and libraries in C++ have no type for it; messages of this project may quote a client.
    if not isinstance(error, CspaceError | ValueError) and _SAYS_EXHAUSTED.search(str(error)):
        return True
    return error.__cause__ is not None and _is_exhausted(error.__cause__)


def failure_response(error: BaseException) -> Response:
    """What a client is told of an error that is no answer to its request; the log has the rest."""
    problem = problem_of(error)
    return problem_response(problem, _ABOUT_THE_SERVER.get(problem, _ABOUT_THE_SERVER[INTERNAL_ERROR]))


def problem_response(
    problem: ProblemType, detail: str, *, headers: Mapping[str, str] | None = None, **members: Any
) -> Response:
    """A problem as ``application/problem+json``; members that are None are left out.

    Below ``/v2`` it is the Open Inference Protocol's ``{"error": detail}``.
    """
    record = request_record.get()
    if record is not None:
        record.reason = problem.name
        if record.path == V2 or record.path.startswith(f"{V2}/"):
            status = _V2_STATUS.get(problem.status, problem.status)
            return Response(json.dumps({"error": detail}), status, dict(headers or {}), "application/json")
    body = {"type": problem.uri, "title": problem.title, "status": problem.status, "detail": detail}
    body |= {name: value for name, value in members.items() if value is not None}
    # ASCII, for a detail may echo half a surrogate pair, which UTF-8 does not have.
    return Response(json.dumps(body), problem.status, dict(headers or {}), MEDIA_TYPE)


def request_problem(error: CspaceError) -> Response:
    """What a client is told of an error of this project."""
    problem = problem_of(error)
    if problem in _ABOUT_THE_SERVER:
        # Its words may hold an address, a path or a secret: they are for the log.
        level = logging.ERROR if problem is INTERNAL_ERROR else logging.WARNING
        _LOG.log(level, "a request failed: %s", error)
        return failure_response(error)
    return problem_response(
        problem,
        str(error),
        headers=error.headers if isinstance(error, RequestError) else None,
        expected=error.expected,
        got=error.got,
        remedy=error.remedy,
        errors=[one.model_dump() for one in error.problems] if isinstance(error, FieldsError) else None,
    )


def add_problem_handlers(app: FastAPI) -> None:
    """Answers every error of the app with a problem."""

    @app.exception_handler(CspaceError)
    def project_error(_: Request, error: CspaceError) -> Response:
        return request_problem(error)

    @app.exception_handler(HTTPException)
    def http_error(_: Request, error: HTTPException) -> Response:
        fallback = MALFORMED_BODY if error.status_code < 500 else INTERNAL_ERROR
        problem = _BY_STATUS.get(error.status_code, fallback)
        detail = str(error.detail) or http.HTTPStatus(error.status_code).phrase
        return problem_response(problem, detail, headers=error.headers)

    @app.exception_handler(ClientDisconnect)
    def gone(_: Request, __: ClientDisconnect) -> Response:
        return problem_response(CLIENT_GONE, "the client went away before its answer")


def brief(value: object) -> str:
    """A short description of an untrusted value; never walks into it, however deep or long it is."""
    if isinstance(value, bytes | list | dict):
        return f"{type(value).__name__} of length {len(value)}"
    if isinstance(value, int) and value.bit_length() > _SHOWN_BITS:
        # Its digits might be more than Python turns into text.
        return f"a whole number of {value.bit_length()} bits"
    return repr(value[:100] if isinstance(value, str) else value)[:120]


def brief_members(values: Mapping[str, object]) -> str:
    """The same for an object's first members."""
    shown = [f"{brief(name)}: {brief(value)}" for name, value in islice(values.items(), 3)]
    return ", ".join([*shown, "..."] if len(values) > len(shown) else shown) or "none"
