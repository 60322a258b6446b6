"""The client of an inference API."""

import json
import logging
import math
import random
import time
from typing import Any, Self, TypeVar

import httpx
import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from cspace_client.answers import (
    Belief,
    Diagnosis,
    FoundPlan,
    Predictions,
    Received,
    SampleBatch,
    as_query,
    seeded,
)
from cspace_client.errors import (
    ConfigError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from cspace_client.pictures import NPY, Part, Picture, form_of, npy_file, shown
from cspace_client.wire import PlanQuery, Problem, SampleAnswer, SampleQuery

_LOG = logging.getLogger("cspace_client")
DEFAULT_TIMEOUT_S, DEFAULT_DEADLINE_S, DEFAULT_RETRIES = 10.0, 30.0, 2
MAX_ANSWER_BYTES = 64 * 2**20
_PAUSE_S = 0.5
# The same request may find an answer later. Not after a time-out: the server still works on the request.
_AGAIN = (httpx.codes.REQUEST_TIMEOUT, httpx.codes.TOO_MANY_REQUESTS, httpx.codes.SERVICE_UNAVAILABLE)
_LOST = (httpx.NetworkError, httpx.RemoteProtocolError)


class _SampleAnswer(SampleAnswer, Received):
    """Samples as they arrive."""


Answered = TypeVar("Answered", bound=Received)


class SamplingClient:
    """Asks an inference API for samples, confidence and paths over kept connections; a context manager.

    A request costs about 1 ms beside the server's work. Never send one from a planner's callback, which
    would stop the search for as long. Lost connections, 429 and 503 are tried again; the seed is drawn here,
    so that it is the same request. Threads may share a client.

    Errors are :class:`cspace_client.SamplerUnavailableError` without an answer in time or from a server that
    fails, and other :class:`cspace_client.SamplerError` for requests that the server refuses. Values that no
    request can have are a ``pydantic.ValidationError``.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``.
        timeout_s: for each read and write.
        connect_timeout_s: for connecting; ``timeout_s`` when None.
        deadline_s: after which no attempt begins, and an answer that still arrives is given up.
        retries: further attempts after the first.
        api_key: sent as ``Authorization: Bearer``.
        robot: digest of the robot that is planned for, of calls that name none: models of others are refused.
            Also its name, where calls name no model.
        transport: of httpx, in place of the network.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        connect_timeout_s: float | None = None,
        deadline_s: float = DEFAULT_DEADLINE_S,
        retries: int = DEFAULT_RETRIES,
        api_key: str | None = None,
        robot: str | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        try:
            address = httpx.URL(url)
        except httpx.InvalidURL:
            address = httpx.URL()
        if address.scheme not in ("http", "https") or not address.host or address.query:
            raise ConfigError("the address is impossible", expected="http://host:port", got=repr(url))
        connect_s = timeout_s if connect_timeout_s is None else connect_timeout_s
        if not all(0.0 < value < math.inf for value in (timeout_s, connect_s, deadline_s)) or retries < 0:
            got = f"{timeout_s}, {connect_s} and {deadline_s} s, {retries} retries"
            raise ConfigError("a time limit is impossible", expected="above 0 s, 0 retries or more", got=got)
        self.url, self._robot = url.rstrip("/"), robot
        self._timeout_s, self._deadline_s, self._retries = timeout_s, deadline_s, retries
        self._http = httpx.Client(
            base_url=self.url,
            headers={} if api_key is None else {"Authorization": f"Bearer {api_key}"},
            timeout=httpx.Timeout(timeout_s, connect=connect_s),
            transport=transport or httpx.HTTPTransport(retries=retries),
            trust_env=False,
        )

    def sample(
        self,
        picture: Picture,
        n: int,
        seed: int | None = None,
        *,
        model: str | None = None,
        robot: str | None = None,
        **options: Any,
    ) -> SampleBatch:
        """At most ``n`` samples; options as :class:`cspace_client.SampleQuery` has them."""
        return self.answer(picture, as_query(SampleQuery, n=n, seed=seed, **options), model, robot)

    def answer(
        self, picture: Picture, query: SampleQuery, model: str | None = None, robot: str | None = None
    ) -> SampleBatch:
        """At most ``query.n`` samples of ``name``, ``name@alias``, ``name/version`` or ``pretrained``."""
        found = self._ask("/sample", _SampleAnswer, picture, model, robot, form_of(seeded(query)))
        return SampleBatch.of(found, found.round_trip_s, found.request_id)

    def validity(
        self,
        picture: Picture,
        configurations: ArrayLike,
        model: str | None = None,
        robot: str | None = None,
        *,
        explain: bool = False,
    ) -> Predictions:
        """A model's confidence that configurations, (n, d) rad, are free."""
        rows = npy_file(np.ascontiguousarray(configurations, dtype="<f8"))
        part = ("configurations", ("configurations.npy", rows, NPY))
        return self._ask(
            "/validity", Predictions, picture, model, robot, {"explain": json.dumps(explain)}, part
        )

    def plan(
        self, picture: Picture, query: PlanQuery, model: str | None = None, robot: str | None = None
    ) -> FoundPlan:
        """A path from start to goal by what a model predicts; the time limits leave room for the search."""
        return self._ask("/plan", FoundPlan, picture, model, robot, form_of(seeded(query)))

    def belief(self, picture: Picture, model: str | None = None, robot: str | None = None) -> Belief:
        """How likely something is in each cell of space, for depth pictures."""
        return self._ask("/belief", Belief, picture, model, robot, {})

    def doctor(self, picture: Picture, model: str | None = None, robot: str | None = None) -> Diagnosis:
        """What is wrong with pictures, cameras and state, and what to do."""
        return self._ask("/doctor", Diagnosis, picture, model, robot, {})

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(
        self,
        path: str,
        kind: type[Answered],
        picture: Picture,
        model: str | None,
        robot: str | None,
        form: dict[str, Any],
        *files: Part,
    ) -> Answered:
        """Sends a request until it is answered, and reads the answer."""
        began = time.perf_counter()
        sent, fields = shown(picture)
        named = {"model": model, "robot": robot or self._robot}
        data = {name: value for name, value in named.items() if value is not None}
        data |= form_of(fields) | form
        for left in range(self._retries, -1, -1):
            try:
                response, body = self._send(path, data, [*sent, *files], began)
            except httpx.TransportError as error:
                pause_s = 0.0
                if not isinstance(error, _LOST) or not self._may_try(left, pause_s, began):
                    raise self._unreachable(error) from error
            else:
                if response.is_success:
                    break
                pause_s = _pause_s(response)
                if response.status_code not in _AGAIN or not self._may_try(left, pause_s, began):
                    raise _error_of(response, body)
            time.sleep(pause_s)
        try:
            found = kind.model_validate_json(body)
        except ValidationError as error:
            remedy = "check that the address is an inference API of this release"
            raise SamplerAnswerError("the answer cannot be read", got=str(error), remedy=remedy) from error
        for one in getattr(found, "warnings", ()):
            _LOG.warning("%s: %s", one.code, one.message)
        round_trip_s, request_id = time.perf_counter() - began, response.headers.get("x-request-id")
        return found.model_copy(update={"round_trip_s": round_trip_s, "request_id": request_id})

    def _send(
        self, path: str, data: dict[str, Any], files: list[Part], began: float
    ) -> tuple[httpx.Response, bytes]:
        """One attempt, bounded in the size of its answer and in time."""
        body = bytearray()
        with self._http.stream("POST", path, data=data, files=files) as response:
            for chunk in response.iter_bytes():
                body += chunk
                if len(body) > MAX_ANSWER_BYTES:
                    expected = f"at most {MAX_ANSWER_BYTES} bytes"
                    raise SamplerAnswerError("the answer is too long", expected=expected)
                if time.perf_counter() - began > self._deadline_s:
                    raise httpx.ReadTimeout("the deadline has passed")
        return response, bytes(body)

    def _may_try(self, left: int, pause_s: float, began: float) -> bool:
        return left > 0 and time.perf_counter() - began + pause_s < self._deadline_s

    def _unreachable(self, error: httpx.TransportError) -> SamplerUnavailableError:
        late = isinstance(error, httpx.TimeoutException)
        return SamplerUnavailableError(
            f"the sampling endpoint {self.url} {'did not answer in time' if late else 'cannot be reached'}",
            expected=f"an answer within {self._timeout_s:g} s, and {self._deadline_s:g} s in all",
            got=f"{type(error).__name__} {error}",
            remedy="check that the inference API runs and that the address is right",
        )


def _pause_s(response: httpx.Response) -> float:
    asked = response.headers.get("retry-after", "")
    least_s = float(asked) if asked.isdecimal() else _PAUSE_S
    return least_s * random.uniform(1.0, 1.2)  # noqa: S311 - no secret


def _error_of(response: httpx.Response, body: bytes) -> SamplerError:
    """What a status that is no success stands for, with the problem's own words (RFC 9457)."""
    status = response.status_code
    try:
        problem = Problem.model_validate_json(body)
    except ValidationError:
        title = f"{status} {response.reason_phrase}"
        problem = Problem(type="about:blank", title=title, status=status, detail="no problem document")
    kind = SamplerModelError if problem.type.endswith(":unknown-model") else SamplerError
    if status in _AGAIN or status >= httpx.codes.INTERNAL_SERVER_ERROR:
        kind = SamplerUnavailableError
    elif status < httpx.codes.BAD_REQUEST:
        kind = SamplerAnswerError
    what = f"the sampling endpoint refused the request: {problem.title} ({problem.type})"
    return kind(what, got=problem.detail)
