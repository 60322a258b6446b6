"""An answer of an inference API as it comes in: what is read of it, and what it stands for.

Every byte is a stranger's. What comes is judged from the head on, so that an answer that can not be used is
given up before its body, and of a body no more is kept than what was asked for can be.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic

import httpx

from cspace_client.answer_errors import printable, unusable
from cspace_client.errors import SamplerAnswerError, SamplerError, SamplerModelError, SamplerUnavailableError
from cspace_client.http.endpoint import Endpoint
from cspace_client.questions.question import Found, Question, Reading
from cspace_client.retries import parse_retry_after

MAX_PROBLEM_BYTES = 64 * 1024
"""Of a problem document."""

_START_REMEDY = "check that the inference API runs and that the address is right"
# Statuses after which the same request may find an answer. A gateway's time-out (504) is not among them: the
# server works on the request, and another would add to that. So it is with a time-out while reading.
_AGAIN = (
    httpx.codes.REQUEST_TIMEOUT,
    httpx.codes.TOO_MANY_REQUESTS,
    httpx.codes.BAD_GATEWAY,
    httpx.codes.SERVICE_UNAVAILABLE,
)
_UNKNOWN_MODEL = ":unknown-model"
_UNKNOWN_FIELD = httpx.codes.UNPROCESSABLE_ENTITY, "an unknown field"
_LOST = (httpx.NetworkError, httpx.ConnectTimeout, httpx.RemoteProtocolError)


@dataclass(frozen=True, slots=True)
class Failure:
    """An attempt that gave no answer.

    Args:
        error: what it stands for.
        again: whether the same request may find an answer later.
        retry_after_s: what the server asks to wait at least, None when it does not.
        knows_no_robot: whether the field ``robot`` alone was too much for the server.
    """

    error: SamplerError
    again: bool = False
    retry_after_s: float | None = None
    knows_no_robot: bool = False


class IncomingAnswer(Generic[Found]):
    """An answer whose head is here and whose body follows.

    Args:
        answer: its head; its body is left to the caller to read.
        question: which it has to answer.
        until: when it has to be here, as ``time.perf_counter()`` counts.

    Raises:
        SamplerAnswerError: the head alone says that it can not be used.
    """

    def __init__(self, answer: httpx.Response, question: Question[Found], until: float) -> None:
        self._answer, self._until = answer, until
        self._reading: Reading[Found] | None = None
        self._limit_bytes = MAX_PROBLEM_BYTES
        if answer.status_code == httpx.codes.OK:
            self._reading = question.read(answer.headers)
            self._limit_bytes = self._reading.limit_bytes
        elif not httpx.codes.is_error(answer.status_code):
            raise unusable("has another status", "200, 4xx or 5xx", f"status {answer.status_code}")
        self._check_framing(answer.headers)
        # Of bytes, not a list of chunks: a chunk may hold a single byte.
        self._body = bytearray()

    def take(self, chunk: bytes) -> None:
        """Keep a piece of the body.

        Raises:
            SamplerAnswerError: it is longer than what was asked for can be.
            httpx.ReadTimeout: it takes too long.
        """
        if len(self._body) + len(chunk) > self._limit_bytes:
            raise self._too_long("more of them")
        # For transports that know of no deadline.
        if time.perf_counter() > self._until:
            raise httpx.ReadTimeout("the deadline has passed")
        self._body += chunk

    def conclude(self, round_trip_s: float) -> Found | Failure:
        """What the whole answer stands for.

        Args:
            round_trip_s: how long it took.

        Raises:
            SamplerAnswerError: it can not be used.
        """
        body = bytes(self._body)
        if self._reading is None:
            return _failure(self._answer, body)
        return self._reading.conclude(body, round_trip_s)

    def _check_framing(self, headers: Mapping[str, str]) -> None:
        # Asked for as it is: what unpacks it would decide how much memory it takes.
        coding = headers.get("content-encoding", "").strip().lower()
        if coding not in ("", "identity"):
            raise unusable("has a content coding", "none", repr(coding[:40]))
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit() and len(length) <= 20):
            raise unusable("has a wrong header content-length", "a whole number", repr(length[:40]))
        if int(length) > self._limit_bytes:
            raise self._too_long(length)

    def _too_long(self, got: str) -> SamplerAnswerError:
        status = self._answer.status_code
        return unusable("is too long", f"at most {self._limit_bytes} bytes", f"{got}, status {status}")


def lost(error: Exception, endpoint: Endpoint) -> Failure:
    """What an attempt stands for that ended with an error instead of an answer.

    Args:
        error: of httpx, or ``TimeoutError`` for the deadline.
        endpoint: that was asked.
    """
    if isinstance(error, httpx.TimeoutException | TimeoutError):
        step_s = endpoint.connect_s if isinstance(error, httpx.ConnectTimeout) else endpoint.timeout_s
        found = SamplerUnavailableError(
            f"the sampling endpoint {endpoint.url} did not answer in time",
            expected=f"an answer within {step_s} s, and {endpoint.policy.deadline_s} s in all",
            got=type(error).__name__,
            remedy=_START_REMEDY,
        )
    else:
        found = SamplerUnavailableError(
            f"the sampling endpoint {endpoint.url} can not be reached",
            got=printable(str(error)) or type(error).__name__,
            remedy=_START_REMEDY,
        )
    # It is raised elsewhere, where the cause would be lost.
    found.__cause__ = error
    return Failure(found, isinstance(error, _LOST))


def _failure(answer: httpx.Response, body: bytes) -> Failure:
    """What a status of 400 or above stands for, with the problem's own words (RFC 9457)."""
    status = answer.status_code
    again, failed = status in _AGAIN, status >= httpx.codes.INTERNAL_SERVER_ERROR
    problem = _problem(answer.headers.get("content-type", ""), body)
    title = printable(problem.get("title") or f"{status} {answer.reason_phrase}".strip())
    named = f" ({printable(problem['type'])})" if problem.get("type") else ""
    # A request that is wrong is the caller's affair; a server that fails is as good as none.
    unknown = problem.get("type", "").endswith(_UNKNOWN_MODEL)
    refused = SamplerModelError if unknown else SamplerError
    kind = SamplerUnavailableError if again or failed else refused
    error = kind(
        f"the sampling endpoint {'failed' if failed else 'refused the request'}: {title}{named}",
        got=printable(problem.get("detail") or f"status {status}"),
    )
    retry_after_s = parse_retry_after(answer.headers.get("retry-after"))
    return Failure(error, again, retry_after_s, status == _UNKNOWN_FIELD[0] and _names_robot(problem))


def _names_robot(problem: Mapping[str, str]) -> bool:
    """Whether the first field that a server objects to is ``robot``, for it knows of none."""
    told = problem.get("detail", "").startswith("robot ")
    return told and problem.get("got") == _UNKNOWN_FIELD[1]


def _problem(media_type: str, body: bytes) -> Mapping[str, str]:
    if "json" not in media_type:
        return {}
    try:
        members = json.loads(body)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(members, dict):
        return {}
    return {name: value for name, value in members.items() if isinstance(value, str)}
