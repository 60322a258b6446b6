"""RFC 9457 problem details: one stable type for each way in which a request can fail."""

import errno
import http
import json
import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fastapi import FastAPI, Request
from fastapi.responses import Response
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
from inference_api.failures import FieldsError, ModelNotReadyError, NoKernelsError, NoRoomError, StartingError
from inference_api.record import note_reason

_LOG = logging.getLogger(__name__)
MEDIA_TYPE = "application/problem+json"
_PREFIX = "urn:cspace-sampler:problem:"


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
    (StartingError, STARTING),
    (NoRoomError, OUT_OF_RESOURCES),
    (StorageError, STORAGE_UNAVAILABLE),
)


class RequestError(CspaceError):
    """A request that is wrong before its values are looked at.

    Args:
        problem: which way.
        what: as :class:`cspace.errors.CspaceError`, and so the rest.
    """

    def __init__(self, problem: ProblemType, what: str, **details: str | None) -> None:
        super().__init__(what, **details)
        self.problem = problem


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
    """A problem as ``application/problem+json``; members that are None are left out."""
    note_reason(problem.name)
    body = {"type": problem.uri, "title": problem.title, "status": problem.status, "detail": detail}
    body |= {name: value for name, value in members.items() if value is not None}
    # ASCII, for a detail may echo half a surrogate pair, which UTF-8 does not have.
    return Response(json.dumps(body), problem.status, dict(headers or {}), MEDIA_TYPE)


def add_problem_handlers(app: FastAPI) -> None:
    """Answer every error of the app with a problem."""

    @app.exception_handler(CspaceError)
    def project_error(_: Request, error: CspaceError) -> Response:
        problem = problem_of(error)
        told = _ABOUT_THE_SERVER.get(problem)
        if told is not None:
            # Its words may hold an address, a path or a secret: they are for the log.
            _LOG.log(
                logging.ERROR if problem is INTERNAL_ERROR else logging.WARNING, "a request failed: %s", error
            )
            return problem_response(problem, told)
        errors = [item.model_dump() for item in error.problems] if isinstance(error, FieldsError) else None
        return problem_response(
            problem,
            str(error),
            expected=error.expected,
            got=error.got,
            remedy=error.remedy,
            errors=errors,
        )

    @app.exception_handler(HTTPException)
    def http_error(_: Request, error: HTTPException) -> Response:
        fallback = MALFORMED_BODY if error.status_code < 500 else INTERNAL_ERROR
        problem = _BY_STATUS.get(error.status_code, fallback)
        detail = str(error.detail) or http.HTTPStatus(error.status_code).phrase
        return problem_response(problem, detail, headers=error.headers)

    @app.exception_handler(ClientDisconnect)
    def gone(_: Request, __: ClientDisconnect) -> Response:
        return problem_response(CLIENT_GONE, "the client went away before its answer")

    @app.exception_handler(Exception)
    def unforeseen(_: Request, error: Exception) -> Response:
        return failure_response(error)
