"""The HTTP client of ``POST /sample``."""

import random
import time
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import Self

import httpx

from cspace.errors import SamplerError, SamplerUnavailableError
from services.planner.http_exchange import (
    Endpoint,
    Failure,
    Question,
    lost,
    read_answer,
)
from services.planner.retries import RetryPolicy
from services.planner.samples import SampleBatch, SampleSource, drawn_seed

__all__ = ["RetryPolicy", "SampleBatch", "SamplingClient"]

DEFAULT_TIMEOUT_S = 10.0
DEFAULT_POLICY = RetryPolicy()


class SamplingClient:
    """Asks an inference API for samples over one kept connection. Use as a context manager, or close it.

    A request costs about 1 ms beside the server's work; never send one from a planner's callback, which would
    stop the search (and the interpreter) for as long. A lost connection, 503 and 429 are tried again; the
    seed, drawn here when none is given, makes that the same request.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``.
        timeout_s: for each read and write.
        connect_timeout_s: for connecting; ``timeout_s`` when None.
        policy: when a request is sent again.
        api_key: sent as ``Authorization: Bearer``; None sends none.
        fallback: answers while the API stays away, with the same seed; the batch says so.
        transport: of httpx; None for the network.

    Raises:
        ConfigError: the address, a time limit or the key can not be.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        connect_timeout_s: float | None = None,
        policy: RetryPolicy = DEFAULT_POLICY,
        api_key: str | None = None,
        fallback: SampleSource | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._endpoint = Endpoint(url, timeout_s, connect_timeout_s, policy, api_key)
        self._fallback = fallback
        self._http = httpx.Client(**self._endpoint.options, transport=transport)

    @property
    def url(self) -> str:
        """Of the API, without a slash at its end."""
        return self._endpoint.url

    def sample(
        self,
        image_png: bytes,
        n: int,
        *,
        model: str | None = None,
        seed: int | None = None,
        epsilon_sigma: Sequence[float] = (),
        start: Sequence[float] | None = None,
        goal: Sequence[float] | None = None,
        min_confidence: float | None = None,
    ) -> SampleBatch:
        """See :class:`services.planner.samples.SampleSource`.

        Raises:
            SamplerUnavailableError: no connection, no answer in time, no model ready (503), or too many
                requests (429), and no fallback that answers.
            SamplerError: the request was refused, or the answer can not be used.
        """
        seed = drawn_seed(seed)
        question = Question(image_png, n, model, seed, epsilon_sigma, start, goal, min_confidence)
        began = time.perf_counter()
        try:
            return self._ask(question, began)
        except SamplerUnavailableError as error:
            if self._fallback is None:
                raise
            try:
                batch = self._fallback.sample(image_png, n, **question.options)
            except SamplerError as refusal:
                raise error from refusal
            return replace(batch, fallback=True, round_trip_s=time.perf_counter() - began)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _ask(self, question: Question, began: float) -> SampleBatch:
        tried = 0
        while True:
            found = self._attempt(question, began)
            if isinstance(found, SampleBatch):
                return found
            tried += 1
            spent_s, draw = time.perf_counter() - began, random.random()  # noqa: S311 - jitter is no secret
            pause_s = self._endpoint.policy.pause_s(tried, spent_s, found.retry_after_s, draw)
            if not found.again or pause_s is None:
                raise found.error
            time.sleep(pause_s)

    def _attempt(self, question: Question, began: float) -> SampleBatch | Failure:
        timeout = self._endpoint.timeout(time.perf_counter() - began)
        try:
            answer = self._http.post(f"{self.url}/sample", timeout=timeout, **question.form)
        except (httpx.HTTPError, httpx.StreamError) as error:
            return lost(error, self._endpoint)
        return read_answer(answer, question.n, time.perf_counter() - began)
