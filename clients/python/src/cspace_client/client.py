"""The clients of an inference API, for programs with threads and for those with an event loop."""

import json
import logging
import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, Self, TypeVar

import anyio
import anyio.to_thread
import httpx
import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from cspace_client.errors import (
    ConfigError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from cspace_client.models import (
    Belief,
    Diagnosis,
    FoundPlan,
    Predictions,
    SampleBatch,
    Source,
    as_query,
    seeded,
)
from cspace_client.pictures import NPY, Part, Picture, form_of, npy_file, shown
from cspace_client.wire import PlanQuery, Problem, SampleAnswer, SampleQuery

_LOG = logging.getLogger("cspace_client")
DEFAULT_TIMEOUT_S, DEFAULT_DEADLINE_S, DEFAULT_RETRIES = 10.0, 30.0, 2
MAX_ANSWER_BYTES = 64 * 2**20
_START_REMEDY = "check that the inference API runs and that the address is right"
_PAUSE_S = 0.5
# The same request may find an answer later. Not after a time-out: the server still works on the request.
_AGAIN = (httpx.codes.REQUEST_TIMEOUT, httpx.codes.TOO_MANY_REQUESTS, httpx.codes.SERVICE_UNAVAILABLE)
_LOST = (httpx.NetworkError, httpx.RemoteProtocolError)

Found = TypeVar("Found")
Told = TypeVar("Told", FoundPlan, Predictions, Diagnosis, Belief)
Reader = Callable[[bytes, float, str | None], Found]
"""Reads an answer's body; the seconds that it took and the request's id go with it."""


@dataclass(frozen=True, slots=True)
class Call(Generic[Found]):
    """A request, and how its answer is read."""

    path: str
    read: Reader[Found]
    form: dict[str, Any]
    files: list[Part]


class _Api:
    """What both clients share: settings, requests, and what becomes of an answer."""

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        connect_timeout_s: float | None = None,
        deadline_s: float = DEFAULT_DEADLINE_S,
        retries: int = DEFAULT_RETRIES,
        api_key: str | None = None,
        fallback: Source | None = None,
        robot: str | None = None,
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
        self.url = url.rstrip("/")
        self._timeout_s, self._deadline_s, self._retries = timeout_s, deadline_s, retries
        self._fallback, self._robot = fallback, robot
        self._settings: dict[str, Any] = {
            "base_url": self.url,
            "headers": {} if api_key is None else {"Authorization": f"Bearer {api_key}"},
            "timeout": httpx.Timeout(timeout_s, connect=connect_s),
            "trust_env": False,
        }

    def _sample(
        self, picture: Picture, query: SampleQuery, model: str | None, robot: str | None
    ) -> Call[SampleBatch]:
        def read(body: bytes, spent_s: float, request_id: str | None) -> SampleBatch:
            return SampleBatch.of(SampleAnswer.model_validate_json(body), spent_s, request_id)

        return self._call("/sample", read, picture, model, form_of(query), robot=robot)

    def _validity(
        self, picture: Picture, configurations: ArrayLike, model: str | None, *, explain: bool
    ) -> Call[Predictions]:
        rows = npy_file(np.ascontiguousarray(configurations, dtype="<f8"))
        form, part = {"explain": json.dumps(explain)}, ("configurations", ("configurations.npy", rows, NPY))
        return self._call("/validity", _reader(Predictions), picture, model, form, part)

    def _plan(self, picture: Picture, query: PlanQuery, model: str | None) -> Call[FoundPlan]:
        return self._call("/plan", _reader(FoundPlan), picture, model, form_of(seeded(query)))

    def _call(
        self,
        path: str,
        read: Reader[Found],
        picture: Picture,
        model: str | None,
        form: dict[str, Any] | None = None,
        *files: Part,
        robot: str | None = None,
    ) -> Call[Found]:
        sent, named = shown(picture), {"model": model, "robot": robot or self._robot}
        given = {name: value for name, value in named.items() if value is not None}
        return Call(path, read, {**form_of(sent.fields), **(form or {}), **given}, [*sent.files, *files])

    def _bound(self, size: int, began: float) -> None:
        """Bounds the size of an answer and the time that it takes."""
        if size > MAX_ANSWER_BYTES:
            raise SamplerAnswerError("the answer is too long", expected=f"at most {MAX_ANSWER_BYTES} bytes")
        if time.perf_counter() - began > self._deadline_s:
            raise httpx.ReadTimeout("the deadline has passed")

    def _after_loss(self, error: httpx.TransportError, tried: int, began: float) -> float:
        """The pause after an attempt without an answer; raises if there is to be no other."""
        if isinstance(error, _LOST) and self._may_try(tried, 0.0, began):
            return 0.0
        late = isinstance(error, httpx.TimeoutException)
        raise SamplerUnavailableError(
            f"the sampling endpoint {self.url} {'did not answer in time' if late else 'cannot be reached'}",
            expected=f"an answer within {self._timeout_s:g} s, and {self._deadline_s:g} s in all",
            got=f"{type(error).__name__} {error}",
            remedy=_START_REMEDY,
        ) from error

    def _after_refusal(self, response: httpx.Response, body: bytes, tried: int, began: float) -> float:
        """The pause after a refusal; raises if there is to be no other attempt."""
        asked = response.headers.get("retry-after", "")
        least_s = float(asked) if asked.isdecimal() else _PAUSE_S
        pause_s = least_s * random.uniform(1.0, 1.2)  # noqa: S311 - no secret
        if response.status_code in _AGAIN and self._may_try(tried, pause_s, began):
            return pause_s
        raise _error_of(response, body)

    def _may_try(self, tried: int, pause_s: float, began: float) -> bool:
        return tried <= self._retries and time.perf_counter() - began + pause_s < self._deadline_s

    def _read(self, call: Call[Found], response: httpx.Response, body: bytes, began: float) -> Found:
        try:
            found = call.read(body, time.perf_counter() - began, response.headers.get("x-request-id"))
        except ValidationError as error:
            remedy = "check that the address is an inference API of this release"
            raise SamplerAnswerError("the answer cannot be read", got=str(error), remedy=remedy) from error
        for one in getattr(found, "warnings", ()):
            _LOG.warning("%s: %s", one.code, one.message)
        return found


def _reader(kind: type[Told]) -> Reader[Told]:
    def read(body: bytes, spent_s: float, request_id: str | None) -> Told:
        answer = kind.model_validate_json(body)
        return answer.model_copy(update={"round_trip_s": spent_s, "request_id": request_id})

    return read


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


class SamplingClient(_Api):
    """Asks an inference API for samples, confidence and paths over kept connections; a context manager.

    A request costs about 1 ms beside the server's work. Never send one from a planner's callback, which
    would stop the search for as long. Lost connections, 429 and 503 are tried again; the seed is drawn here,
    so that it is the same request.

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
        fallback: answers samples with the same seed while the API is away; the batch says so.
        robot: digest of the robot that is planned for: models of others are refused. Also its name, where
            calls name no model.
        transport: of httpx, in place of the network.
    """

    def __init__(
        self, url: str, *values: Any, transport: httpx.BaseTransport | None = None, **options: Any
    ) -> None:
        super().__init__(url, *values, **options)
        network = transport or httpx.HTTPTransport(retries=self._retries)
        self._http = httpx.Client(transport=network, **self._settings)

    def sample(
        self, picture: Picture, n: int, seed: int | None = None, *, model: str | None = None, **options: Any
    ) -> SampleBatch:
        """At most ``n`` samples; options as :class:`cspace_client.SampleQuery` has them."""
        return self.answer(picture, as_query(SampleQuery, n=n, seed=seed, **options), model)

    def answer(
        self, picture: Picture, query: SampleQuery, model: str | None = None, robot: str | None = None
    ) -> SampleBatch:
        """At most ``query.n`` samples of ``name``, ``name@alias``, ``name/version`` or ``pretrained``."""
        began, query = time.perf_counter(), seeded(query)
        try:
            return self._send(self._sample(picture, query, model, robot))
        except SamplerUnavailableError as error:
            if self._fallback is None:
                raise
            try:
                batch = self._fallback.answer(picture, query, model, robot or self._robot)
            except SamplerError as refusal:
                raise error from refusal
            return replace(batch, fallback=True, round_trip_s=time.perf_counter() - began)

    def validity(
        self, picture: Picture, configurations: ArrayLike, model: str | None = None, *, explain: bool = False
    ) -> Predictions:
        """A model's confidence that configurations, (n, d) rad, are free."""
        return self._send(self._validity(picture, configurations, model, explain=explain))

    def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """A path from start to goal by what a model predicts; the time limits leave room for the search."""
        return self._send(self._plan(picture, query, model))

    def belief(self, picture: Picture, model: str | None = None) -> Belief:
        """How likely something is in each cell of space, for depth pictures."""
        return self._send(self._call("/belief", _reader(Belief), picture, model))

    def doctor(self, picture: Picture, model: str | None = None) -> Diagnosis:
        """What is wrong with pictures, cameras and state, and what to do."""
        return self._send(self._call("/doctor", _reader(Diagnosis), picture, model))

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, call: Call[Found]) -> Found:
        began, tried = time.perf_counter(), 0
        while True:
            tried += 1
            try:
                with self._http.stream("POST", call.path, data=call.form, files=call.files) as response:
                    body = bytearray()
                    for chunk in response.iter_bytes():
                        body += chunk
                        self._bound(len(body), began)
            except httpx.TransportError as error:
                pause_s = self._after_loss(error, tried, began)
            else:
                if response.is_success:
                    return self._read(call, response, bytes(body), began)
                pause_s = self._after_refusal(response, bytes(body), tried, began)
            time.sleep(pause_s)


class AsyncSamplingClient(_Api):
    """As :class:`cspace_client.SamplingClient`, awaited; fallbacks answer in a thread."""

    def __init__(
        self, url: str, *values: Any, transport: httpx.AsyncBaseTransport | None = None, **options: Any
    ) -> None:
        super().__init__(url, *values, **options)
        network = transport or httpx.AsyncHTTPTransport(retries=self._retries)
        self._http = httpx.AsyncClient(transport=network, **self._settings)

    async def sample(
        self, picture: Picture, n: int, seed: int | None = None, *, model: str | None = None, **options: Any
    ) -> SampleBatch:
        """As of :class:`cspace_client.SamplingClient`."""
        return await self.answer(picture, as_query(SampleQuery, n=n, seed=seed, **options), model)

    async def answer(
        self, picture: Picture, query: SampleQuery, model: str | None = None, robot: str | None = None
    ) -> SampleBatch:
        """As of :class:`cspace_client.SamplingClient`."""
        began, query = time.perf_counter(), seeded(query)
        try:
            return await self._send(self._sample(picture, query, model, robot))
        except SamplerUnavailableError as error:
            if self._fallback is None:
                raise
            asked = picture, query, model, robot or self._robot
            try:
                batch = await anyio.to_thread.run_sync(self._fallback.answer, *asked)
            except SamplerError as refusal:
                raise error from refusal
            return replace(batch, fallback=True, round_trip_s=time.perf_counter() - began)

    async def validity(
        self, picture: Picture, configurations: ArrayLike, model: str | None = None, *, explain: bool = False
    ) -> Predictions:
        """As of :class:`cspace_client.SamplingClient`."""
        return await self._send(self._validity(picture, configurations, model, explain=explain))

    async def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """As of :class:`cspace_client.SamplingClient`."""
        return await self._send(self._plan(picture, query, model))

    async def belief(self, picture: Picture, model: str | None = None) -> Belief:
        """As of :class:`cspace_client.SamplingClient`."""
        return await self._send(self._call("/belief", _reader(Belief), picture, model))

    async def doctor(self, picture: Picture, model: str | None = None) -> Diagnosis:
        """As of :class:`cspace_client.SamplingClient`."""
        return await self._send(self._call("/doctor", _reader(Diagnosis), picture, model))

    async def aclose(self) -> None:
        """Closes the connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()

    async def _send(self, call: Call[Found]) -> Found:
        began, tried = time.perf_counter(), 0
        while True:
            tried += 1
            try:
                async with self._http.stream("POST", call.path, data=call.form, files=call.files) as response:
                    body = bytearray()
                    async for chunk in response.aiter_bytes():
                        body += chunk
                        self._bound(len(body), began)
            except httpx.TransportError as error:
                pause_s = self._after_loss(error, tried, began)
            else:
                if response.is_success:
                    return self._read(call, response, bytes(body), began)
                pause_s = self._after_refusal(response, bytes(body), tried, began)
            await anyio.sleep(pause_s)
