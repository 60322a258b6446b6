"""Requests to the sampling endpoint and its answers, apart from how they travel: shared by both clients."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import httpx

from cspace.errors import ConfigError, SamplerError, SamplerUnavailableError
from services.planner.npy_answer import NPY, read_batch
from services.planner.retries import RetryPolicy, parse_retry_after
from services.planner.samples import SampleBatch

_START_REMEDY = "check that the inference API runs and that the address is right"
# Statuses after which the same request may find an answer.
_AGAIN = (httpx.codes.TOO_MANY_REQUESTS, httpx.codes.SERVICE_UNAVAILABLE)
# A time-out while reading is not among them: the server works on the request, and another would add to that.
_LOST = (httpx.NetworkError, httpx.ConnectTimeout, httpx.RemoteProtocolError)
# Shorter than what the server keeps an idle connection for, so that it is the client that closes it.
LIMITS = httpx.Limits(max_connections=100, max_keepalive_connections=20, keepalive_expiry=45.0)


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where a client asks and how patiently.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``; a slash at its end is taken away.
        timeout_s: for each read and write.
        connect_timeout_s: for connecting; ``timeout_s`` when None.
        policy: when a request is sent again.
        api_key: sent as ``Authorization: Bearer``; None sends none.

    Raises:
        ConfigError: the address, a time limit or the key can not be.
    """

    url: str
    timeout_s: float
    connect_timeout_s: float | None
    policy: RetryPolicy
    api_key: str | None = field(repr=False)

    def __post_init__(self) -> None:
        limits = (
            self.timeout_s,
            self.timeout_s if self.connect_timeout_s is None else self.connect_timeout_s,
        )
        if not all(0.0 < limit < math.inf for limit in limits):
            raise ConfigError(
                "the client's time limit is out of range", expected="above 0", got=f"{limits[0]}, {limits[1]}"
            )
        key = self.api_key
        if key is not None and not (key and key.isascii() and key.isprintable() and " " not in key):
            raise ConfigError("the API key can not be", expected="printable ASCII without spaces")
        object.__setattr__(self, "url", _checked(self.url))

    @property
    def connect_s(self) -> float:
        """Time limit for connecting."""
        return self.timeout_s if self.connect_timeout_s is None else self.connect_timeout_s

    @property
    def headers(self) -> dict[str, str]:
        """What every request carries."""
        key = {} if self.api_key is None else {"Authorization": f"Bearer {self.api_key}"}
        return {"Accept": f"{NPY}, application/problem+json", **key}

    @property
    def options(self) -> dict[str, Any]:
        """Of httpx's client; without the environment's proxies, for loopback must not leave the machine."""
        return {"headers": self.headers, "limits": LIMITS, "trust_env": False}

    def timeout(self, spent_s: float) -> httpx.Timeout:
        """Time limits of an attempt, within what the deadline leaves."""
        left = max(self.policy.deadline_s - spent_s, 1e-3)
        return httpx.Timeout(min(self.timeout_s, left), connect=min(self.connect_s, left))


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """One request, which may be sent more than once: its seed makes every answer to it the same.

    Args:
        image_png: the scenario's picture as a PNG file.
        n: how many samples.
        model: as :class:`services.planner.samples.SampleSource` has it, and so the rest.
        seed: drawn when it was not given.
    """

    image_png: bytes
    n: int
    model: str | None
    seed: int
    epsilon_sigma: Sequence[float]
    start: Sequence[float] | None
    goal: Sequence[float] | None
    min_confidence: float | None

    @property
    def fields(self) -> dict[str, Any]:
        """The form's fields; what was not given is left to the endpoint."""
        fields: dict[str, Any] = {"n": str(self.n), "seed": str(self.seed)}
        if self.min_confidence is not None:
            fields["min_confidence"] = repr(float(self.min_confidence))
        if self.model is not None:
            fields["model"] = self.model
        if len(self.epsilon_sigma):
            fields["epsilon_sigma"] = [repr(float(value)) for value in self.epsilon_sigma]
        for name, angles in (("start", self.start), ("goal", self.goal)):
            if angles is not None:
                fields[name] = json.dumps([float(angle) for angle in angles])
        return fields

    @property
    def form(self) -> dict[str, Any]:
        """The arguments of an httpx request."""
        return {"data": self.fields, "files": {"image": ("scenario.png", self.image_png, "image/png")}}

    @property
    def options(self) -> dict[str, Any]:
        """The keyword arguments of :meth:`services.planner.samples.SampleSource.sample`."""
        return {
            "model": self.model,
            "seed": self.seed,
            "epsilon_sigma": self.epsilon_sigma,
            "start": self.start,
            "goal": self.goal,
            "min_confidence": self.min_confidence,
        }


@dataclass(frozen=True, slots=True)
class Failure:
    """An attempt that gave no samples.

    Args:
        error: what it stands for.
        again: whether the same request may find an answer later.
        retry_after_s: what the server asks to wait at least, None when it does not.
    """

    error: SamplerError
    again: bool = False
    retry_after_s: float | None = None


def read_answer(answer: httpx.Response, n: int, round_trip_s: float) -> SampleBatch | Failure:
    """The batch of an answer, or why there is none.

    Args:
        answer: whole.
        n: how many samples were asked for.
        round_trip_s: how long it took.
    """
    if answer.status_code != httpx.codes.OK:
        again = answer.status_code in _AGAIN
        return Failure(_refusal(answer), again, parse_retry_after(answer.headers.get("retry-after")))
    try:
        return read_batch(answer.content, answer.headers, n, round_trip_s)
    except SamplerError as error:
        return Failure(error)


def lost(error: httpx.HTTPError | httpx.StreamError, endpoint: Endpoint) -> Failure:
    """What an error of httpx stands for."""
    if isinstance(error, httpx.TimeoutException):
        limit_s = endpoint.connect_s if isinstance(error, httpx.ConnectTimeout) else endpoint.timeout_s
        found = SamplerUnavailableError(
            f"the sampling endpoint {endpoint.url} did not answer in time",
            expected=f"an answer within {limit_s} s",
            got=type(error).__name__,
            remedy=_START_REMEDY,
        )
    else:
        found = SamplerUnavailableError(
            f"the sampling endpoint {endpoint.url} can not be reached",
            got=str(error) or type(error).__name__,
            remedy=_START_REMEDY,
        )
    # It is raised elsewhere, where the cause would be lost.
    found.__cause__ = error
    return Failure(found, isinstance(error, _LOST))


def _checked(url: str) -> str:
    try:
        parsed = httpx.URL(url)
    except (httpx.InvalidURL, TypeError) as error:
        raise _bad_url(url) from error
    if parsed.scheme not in ("http", "https") or not parsed.host or parsed.query or parsed.fragment:
        raise _bad_url(url)
    return url.rstrip("/")


def _bad_url(url: str) -> ConfigError:
    return ConfigError(
        "the sampling endpoint's address can not be",
        expected="http://host:port",
        got=repr(url),
        remedy="for example http://127.0.0.1:8000",
    )


def _refusal(answer: httpx.Response) -> SamplerError:
    """The error that an answer other than 200 stands for, with the problem's own words (RFC 9457)."""
    problem = _problem(answer)
    kind = SamplerUnavailableError if answer.status_code in _AGAIN else SamplerError
    title = problem.get("title") or f"{answer.status_code} {answer.reason_phrase}".strip()
    named = f" ({problem['type']})" if problem.get("type") else ""
    got = problem.get("detail") or f"status {answer.status_code}"
    return kind(f"the sampling endpoint refused the request: {title}{named}", got=got)


def _problem(answer: httpx.Response) -> Mapping[str, str]:
    if "json" not in answer.headers.get("content-type", ""):
        return {}
    try:
        members = answer.json()
    except (ValueError, RecursionError):
        return {}
    if not isinstance(members, dict):
        return {}
    return {name: value for name, value in members.items() if isinstance(value, str)}
