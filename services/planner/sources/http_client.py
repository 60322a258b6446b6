"""What both HTTP clients are: where they ask and how patiently, and who answers in the API's stead."""

import random
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Generic, TypeVar

import httpx
from numpy.typing import ArrayLike

from cspace.errors import ConfigError
from cspace.planning.query import PlanQuery
from cspace.query import SampleQuery, is_digest
from services.planner.sources.http_answer import Failure
from services.planner.sources.http_exchange import Endpoint
from services.planner.sources.questions.plan_question import PlanQuestion
from services.planner.sources.questions.question import Found, Question, picture_file
from services.planner.sources.questions.sample_question import SampleQuestion
from services.planner.sources.questions.validity_question import ValidityQuestion, rows_of
from services.planner.sources.retries import RetryPolicy
from services.planner.sources.samples import Picture, SampleSource, for_robot

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
        robot: str | None = None,
    ) -> None:
        if robot is not None and not is_digest(robot):
            raise ConfigError("robot is no digest", expected="64 hexadecimal digits", got=repr(robot)[:200])
        self._endpoint = Endpoint(url, timeout_s, connect_timeout_s, policy, api_key)
        self._fallback = fallback
        self._closed = False
        self._robot, self._tells_robot = robot, True
        self._transport: Transport = self._network() if transport is None else transport

    @property
    def url(self) -> str:
        """Of the API, without a slash at its end."""
        return self._endpoint.url

    @staticmethod
    @abstractmethod
    def _network() -> Transport: ...

    def _of_samples(self, picture: Picture, query: SampleQuery, model: str | None) -> SampleQuestion:
        query = for_robot(query, self._robot)
        given = picture_file(picture), model, query.robot, query.require_confirmed, self._tells_robot
        return SampleQuestion(*given, query)

    def _of_validity(self, picture: Picture, rows: ArrayLike, model: str | None) -> ValidityQuestion:
        given = picture_file(picture), model, self._robot, False, self._tells_robot
        return ValidityQuestion(*given, rows_of(rows))

    def _of_plan(self, picture: Picture, query: PlanQuery, model: str | None) -> PlanQuestion:
        given = picture_file(picture), model, self._robot, False, self._tells_robot
        return PlanQuestion(*given, query)

    def _untold(self, question: Question[Found], found: Failure) -> Question[Found] | None:
        """The question without its robot, where it failed for an older server knows no such field; else None.

        From then on it is not sent; the robot of an answer is looked at all the same.
        """
        if not (found.knows_no_robot and question.tells_robot):
            return None
        self._tells_robot = False
        return replace(question, tells_robot=False)

    def _pause_s(self, failure: Failure, tried: int, began: float) -> float:
        """How long to wait before another attempt; raises the failure's error where there is none."""
        spent_s, draw = time.perf_counter() - began, random.random()  # noqa: S311 - jitter is no secret
        pause_s = self._endpoint.policy.pause_s(tried, spent_s, failure.retry_after_s, draw)
        if not failure.again or pause_s is None:
            raise failure.error
        return pause_s
