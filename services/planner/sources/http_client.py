"""What both HTTP clients are: where they ask and how patiently, and who answers in the API's stead."""

import random
import time
from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import httpx

from services.planner.sources.http_answer import Failure
from services.planner.sources.http_exchange import Endpoint
from services.planner.sources.retries import RetryPolicy
from services.planner.sources.samples import SampleSource

DEFAULT_TIMEOUT_S = 10.0
DEFAULT_POLICY = RetryPolicy()

Transport = TypeVar("Transport", httpx.BaseTransport, httpx.AsyncBaseTransport)


class HttpClient(ABC, Generic[Transport]):
    """The arguments are those of :class:`services.planner.sources.sampling_client.SamplingClient`."""

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        connect_timeout_s: float | None = None,
        policy: RetryPolicy = DEFAULT_POLICY,
        api_key: str | None = None,
        fallback: SampleSource | None = None,
        transport: Transport | None = None,
    ) -> None:
        self._endpoint = Endpoint(url, timeout_s, connect_timeout_s, policy, api_key)
        self._fallback = fallback
        self._closed = False
        self._transport: Transport = self._network() if transport is None else transport

    @property
    def url(self) -> str:
        """Of the API, without a slash at its end."""
        return self._endpoint.url

    @staticmethod
    @abstractmethod
    def _network() -> Transport: ...

    def _pause_s(self, failure: Failure, tried: int, began: float) -> float:
        """How long to wait before another attempt; raises the failure's error where there is none."""
        spent_s, draw = time.perf_counter() - began, random.random()  # noqa: S311 - jitter is no secret
        pause_s = self._endpoint.policy.pause_s(tried, spent_s, failure.retry_after_s, draw)
        if not failure.again or pause_s is None:
            raise failure.error
        return pause_s
