"""How a request travels: retries, one deadline for all of it, and the answer as it comes in."""

import base64
import json
import math
import random
import socket
import ssl
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, Generic

import httpcore
import httpx

from cspace_client.errors import (
    ConfigError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
    printable,
    unusable,
)
from cspace_client.requests import Answer, Found, Question

_MAX_DIGITS = 9
_MAX_DATE = 64


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How often and how long.

    Args:
        attempts: requests in all, at least 1; 1 never sends a request again.
        base_s: bound of the first pause; it doubles from pause to pause.
        cap_s: largest bound of a pause.
        deadline_s: after the first attempt began no other begins, and the one that goes on is given up,
            however little it needs for each of its reads.

    Raises:
        ConfigError: a value is out of range.
    """

    attempts: int = 4
    base_s: float = 0.1
    cap_s: float = 2.0
    deadline_s: float = 30.0

    def __post_init__(self) -> None:
        times = (self.base_s, self.cap_s, self.deadline_s)
        if self.attempts < 1 or not all(0.0 < value < math.inf for value in times):
            raise ConfigError(
                "the client's retries are out of range", expected="1 attempt and 0 s or more", got=repr(self)
            )

    def pause_s(self, tried: int, spent_s: float, retry_after_s: float | None, draw: float) -> float | None:
        """The pause before the next attempt, None to give up.

        Full jitter spreads the clients that a server's pause has brought into step: the pause is uniform
        between 0 and min(cap, base 2^(tried - 1)).

        Args:
            tried: attempts so far, at least 1.
            spent_s: since the first one began.
            retry_after_s: what the server asks to wait at least.
            draw: uniform in [0, 1).
        """
        pause = draw * min(self.cap_s, self.base_s * 2.0 ** min(tried - 1, 64))
        pause = max(pause, retry_after_s or 0.0)
        return None if tried >= self.attempts or spent_s + pause >= self.deadline_s else pause


def parse_retry_after(value: str | None, now: datetime | None = None) -> float | None:
    """The header ``Retry-After`` (RFC 9110, 10.2.3) in s, 0 to infinity; None when absent or neither form.

    Args:
        value: seconds or an HTTP date.
        now: the time to which a date is compared; the clock's when None.
    """
    text = (value or "").strip()
    if text.isascii() and text.isdigit():
        # Longer than anybody waits; a caller gives up.
        return float(text) if len(text) <= _MAX_DIGITS else math.inf
    if len(text) > _MAX_DATE:
        return None
    try:
        date = parsedate_to_datetime(text)
        date = date if date.tzinfo else date.replace(tzinfo=UTC)
        return max(0.0, (date - (now or datetime.now(UTC))).total_seconds())
    # A year or a zone of many digits overflows.
    except (ValueError, OverflowError):
        return None


# Shorter than what the server keeps an idle connection for, so that it is the client that closes it.
LIMITS = httpx.Limits(max_connections=100, max_keepalive_connections=20, keepalive_expiry=45.0)


class Endpoint:
    """Where a client asks and how patiently.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``; a slash at its end is taken away.
        timeout_s: for each read and write, within what the policy's deadline leaves.
        connect_timeout_s: for connecting; ``timeout_s`` when None.
        policy: when a request is sent again, and when it is given up.
        api_key: sent as ``Authorization: Bearer``; None sends none.

    Raises:
        ConfigError: the address, a time limit or the key can not be.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float,
        connect_timeout_s: float | None,
        policy: RetryPolicy,
        api_key: str | None,
    ) -> None:
        self.timeout_s, self.policy = timeout_s, policy
        self.connect_s = timeout_s if connect_timeout_s is None else connect_timeout_s
        if not all(0.0 < limit < math.inf for limit in (self.timeout_s, self.connect_s)):
            raise ConfigError(
                "the client's time limit is out of range",
                expected="above 0",
                got=f"{self.timeout_s}, {self.connect_s}",
            )
        if api_key is not None and not (
            api_key and api_key.isascii() and api_key.isprintable() and " " not in api_key
        ):
            raise ConfigError("the API key can not be", expected="printable ASCII without spaces")
        self.url = _checked(url)
        self._headers = _headers(self.url, api_key)

    def timeout(self, spent_s: float) -> httpx.Timeout:
        """Time limits of an attempt, within what the deadline leaves."""
        left = max(self.policy.deadline_s - spent_s, 1e-3)
        # Half for the connection and half for TLS, which have this limit each: cut short by the deadline
        # itself, the awaited transport would leave a socket in the middle of its handshake open.
        return httpx.Timeout(min(self.timeout_s, left), connect=min(self.connect_s, 0.5 * left))

    def request(self, question: Question[Any], spent_s: float) -> httpx.Request:
        """A question as it is sent.

        Transports are given it as it is. A client of httpx would store a stranger's cookies and look at where
        he redirects to.
        """
        form = {"data": question.fields, "files": question.files}
        return self.post(question.path, spent_s, question.media_type, **form)

    def post(self, path: str, spent_s: float, media_type: str = "*/*", **body: Any) -> httpx.Request:
        """A request with a body, in the arguments of ``httpx.Request``; see :meth:`request`."""
        return httpx.Request(
            "POST",
            f"{self.url}{path}",
            headers=self._headers | {"Accept": f"{media_type}, application/problem+json"},
            extensions={"timeout": self.timeout(spent_s).as_dict()},
            **body,
        )


def _headers(url: str, key: str | None) -> dict[str, str]:
    """What every request carries; an address with a name and a password has them before the key."""
    headers = {
        # The body as it is: what unpacks it would decide how much memory an answer takes.
        "Accept-Encoding": "identity",
        "Connection": "keep-alive",
        "User-Agent": f"python-httpx/{httpx.__version__}",
    }
    parsed = httpx.URL(url)
    if parsed.username or parsed.password:
        pair = f"{parsed.username}:{parsed.password}".encode()
        headers["Authorization"] = f"Basic {base64.b64encode(pair).decode()}"
    elif key is not None:
        headers["Authorization"] = f"Bearer {key}"
    return headers


def _checked(url: str) -> str:
    try:
        parsed = httpx.URL(url)
        fits = parsed.scheme in ("http", "https") and parsed.host and not (parsed.query or parsed.fragment)
    except (httpx.InvalidURL, TypeError):
        fits = False
    if not fits:
        raise ConfigError(
            "the sampling endpoint's address can not be",
            expected="http://host:port",
            got=repr(url),
            remedy="for example http://127.0.0.1:8000",
        )
    return url.rstrip("/")


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
_LOST = (httpx.NetworkError, httpx.ConnectTimeout, httpx.RemoteProtocolError)


@dataclass(frozen=True, slots=True)
class Failure:
    """An attempt that gave no answer.

    Args:
        error: what it stands for.
        again: whether the same request may find an answer later.
        retry_after_s: what the server asks to wait at least, None when it does not.
    """

    error: SamplerError
    again: bool = False
    retry_after_s: float | None = None

    def pause_s(self, policy: RetryPolicy, tried: int, began: float) -> float | None:
        """How long to wait before the next attempt, None to give up.

        Args:
            policy: by which.
            tried: attempts so far.
            began: the first one, as ``time.perf_counter()`` counts.
        """
        spent_s, draw = time.perf_counter() - began, random.random()  # noqa: S311 - jitter is no secret
        return policy.pause_s(tried, spent_s, self.retry_after_s, draw) if self.again else None


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
        self._answer, self._question, self._until = answer, question, until
        self._limit_bytes = MAX_PROBLEM_BYTES
        if answer.status_code == httpx.codes.OK:
            self._limit_bytes = question.limit_bytes
            media_type = _media_type(answer.headers)
            if media_type != question.media_type:
                raise unusable("has another media type", question.media_type, repr(media_type))
        elif not httpx.codes.is_error(answer.status_code):
            raise unusable("has another status", "200, 4xx or 5xx", f"status {answer.status_code}")
        # Asked for as it is: what unpacks it would decide how much memory it takes.
        coding = answer.headers.get("content-encoding", "").strip().lower()
        if coding not in ("", "identity"):
            raise unusable("has a content coding", "none", repr(coding[:40]))
        # Of bytes, not a list of chunks: a chunk may hold a single byte.
        self._body = bytearray()

    def take(self, chunk: bytes) -> None:
        """Keep a piece of the body.

        Raises:
            SamplerAnswerError: it is longer than what was asked for can be.
            httpx.ReadTimeout: it takes too long.
        """
        if len(self._body) + len(chunk) > self._limit_bytes:
            raise unusable(
                "is too long",
                f"at most {self._limit_bytes} bytes",
                f"more of them, status {self._answer.status_code}",
            )
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
        if self._answer.status_code != httpx.codes.OK:
            return failure_of(self._answer, body)
        return self._question.read(Answer(self._answer.headers, body, round_trip_s))


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


def failure_of(answer: httpx.Response, body: bytes) -> Failure:
    """What a status of 400 or above stands for, with the problem's own words (RFC 9457)."""
    status = answer.status_code
    again, failed = status in _AGAIN, status >= httpx.codes.INTERNAL_SERVER_ERROR
    problem = _problem(body) if "json" in _media_type(answer.headers) else {}
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
    return Failure(error, again, parse_retry_after(answer.headers.get("retry-after")))


def _media_type(headers: Mapping[str, str]) -> str:
    return headers.get("content-type", "").partition(";")[0].strip().lower()


def _problem(body: bytes) -> Mapping[str, str]:
    try:
        members = json.loads(body)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(members, dict):
        return {}
    return {name: value for name, value in members.items() if isinstance(value, str)}


_UNTIL: ContextVar[float] = ContextVar("until", default=math.inf)


@contextmanager
def deadline(until: float) -> Iterator[None]:
    """Requests of this context are given up at a point in time, answers that are still read among them.

    Args:
        until: as ``time.perf_counter()`` counts, s.
    """
    token = _UNTIL.set(until)
    try:
        yield
    finally:
        _UNTIL.reset(token)


class DeadlineTransport(httpx.HTTPTransport):
    """As ``httpx.HTTPTransport`` without proxies and HTTP/2, within :func:`deadline`.

    Args:
        limits: of its connections.
    """

    def __init__(self, limits: httpx.Limits) -> None:
        context = httpx.create_ssl_context(trust_env=False)
        super().__init__(context, trust_env=False, limits=limits)
        # httpx has no argument for what lies under its pool.
        self._pool = httpcore.ConnectionPool(
            ssl_context=context,
            max_connections=limits.max_connections,
            max_keepalive_connections=limits.max_keepalive_connections,
            keepalive_expiry=limits.keepalive_expiry,
            network_backend=_Backend(),
        )


class _Backend(httpcore.NetworkBackend):
    def __init__(self) -> None:
        self._sockets = httpcore.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.NetworkStream:
        options = list(socket_options or ())
        failed: Exception = httpcore.ConnectError(f"{host} has no address")
        # One address at a time: the time limit would else begin again with every address of the host.
        for address in _addresses(host, port):
            left_s = _left_s(timeout)
            try:
                return _Stream(self._sockets.connect_tcp(address, port, left_s, local_address, options))
            except (httpcore.ConnectError, httpcore.ConnectTimeout) as error:
                failed = error
        raise failed


class _Stream(httpcore.NetworkStream):
    def __init__(self, inner: httpcore.NetworkStream) -> None:
        self._inner = inner

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._inner.read(max_bytes, _left_s(timeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        link: socket.socket = self._inner.get_extra_info("socket")
        rest = memoryview(buffer)
        try:
            # Not sendall, nor the inner stream's: a server that takes a few bytes at a time would start the
            # time limit again with each of them.
            while rest:
                link.settimeout(_left_s(timeout))
                rest = rest[link.send(rest) :]
        except TimeoutError as error:
            raise httpcore.WriteTimeout(str(error)) from error
        except OSError as error:
            raise httpcore.WriteError(str(error)) from error

    def close(self) -> None:
        self._inner.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        try:
            left_s = _left_s(timeout)
        except TimeoutError:
            self.close()
            raise
        return _Stream(self._inner.start_tls(ssl_context, server_hostname, left_s))

    def get_extra_info(self, info: str) -> Any:
        return self._inner.get_extra_info(info)


def _addresses(host: str, port: int) -> list[str]:
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise httpcore.ConnectError(str(error)) from error
    # A link-local address of IPv6 is nothing without its scope.
    return [f"{at[0]}%{at[3]}" if len(at) == 4 and at[3] else str(at[0]) for *_, at in found]


def _left_s(timeout: float | None) -> float | None:
    """What an operation may take.

    Raises:
        TimeoutError: the deadline has passed.
    """
    left_s = _UNTIL.get() - time.perf_counter()
    if left_s <= 0.0:
        raise TimeoutError("the deadline has passed")
    within_s = left_s if timeout is None else min(timeout, left_s)
    return None if within_s == math.inf else within_s
