"""What both HTTP clients are: where they ask and how patiently, and who answers in the API's stead."""

import random
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Generic, TypeVar

import httpx
from numpy.typing import ArrayLike

from cspace_client.errors import ConfigError
from cspace_client.http.answer import Failure
from cspace_client.http.endpoint import Endpoint
from cspace_client.pictures import Picture, shown
from cspace_client.plans import PlanWanted
from cspace_client.questions.plan_question import PlanQuestion
from cspace_client.questions.question import Found, Question
from cspace_client.questions.sample_question import SampleQuestion
from cspace_client.questions.validity_question import ValidityQuestion, rows_of
from cspace_client.retries import RetryPolicy
from cspace_client.samples import SampleQuery, Source, Wanted, is_digest

DEFAULT_TIMEOUT_S = 10.0
DEFAULT_POLICY = RetryPolicy()

Transport = TypeVar("Transport", httpx.BaseTransport, httpx.AsyncBaseTransport)


class HttpClient(ABC, Generic[Transport]):
    """The arguments are those of :class:`cspace_client.SamplingClient`."""

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        connect_timeout_s: float | None = None,
        policy: RetryPolicy = DEFAULT_POLICY,
        api_key: str | None = None,
        fallback: Source | None = None,
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

    def _of_samples(self, picture: Picture, query: Wanted, model: str | None) -> SampleQuestion:
        query = self._for_robot(query)
        given = shown(picture), model, query.robot, self._tells_robot
        return SampleQuestion(*given, query)

    def _of_validity(self, picture: Picture, rows: ArrayLike, model: str | None) -> ValidityQuestion:
        given = shown(picture), model, self._robot, self._tells_robot
        return ValidityQuestion(*given, rows_of(rows))

    def _of_plan(self, picture: Picture, query: PlanWanted, model: str | None) -> PlanQuestion:
        given = shown(picture), model, self._robot, self._tells_robot
        return PlanQuestion(*given, query)

    def _for_robot(self, query: Wanted) -> Wanted:
        """A query for the robot that it names, else for the client's."""
        if self._robot is None or query.robot is not None:
            return query
        return SampleQuery(
            query.n,
            query.seed,
            query.epsilon_sigma,
            query.start,
            query.goal,
            query.min_confidence,
            self._robot,
        )

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
