"""The clients of an inference API, for programs with threads and for those with an event loop."""

import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Generic, Self, TypeVar, Unpack, cast

import anyio
import anyio.to_thread
import httpx
from numpy.typing import ArrayLike

from cspace_client.errors import ConfigError, SamplerAnswerError, SamplerError, SamplerUnavailableError
from cspace_client.models import (
    Belief,
    Diagnosis,
    FoundPlan,
    PlanQuery,
    QueryOptions,
    SampleBatch,
    SampleQuery,
    Source,
    is_digest,
)
from cspace_client.pictures import Picture, shown
from cspace_client.requests import (
    BeliefQuestion,
    DoctorQuestion,
    Found,
    PlanQuestion,
    Predictions,
    Question,
    SampleQuestion,
    ValidityQuestion,
    rows_of,
)
from cspace_client.transport import (
    LIMITS,
    DeadlineTransport,
    Endpoint,
    Failure,
    IncomingAnswer,
    RetryPolicy,
    deadline,
    lost,
)

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
        self._robot = robot
        self._transport: Transport = self._network() if transport is None else transport

    @property
    def url(self) -> str:
        """Of the API, without a slash at its end."""
        return self._endpoint.url

    @staticmethod
    @abstractmethod
    def _network() -> Transport: ...

    def _of_samples(self, picture: Picture, query: SampleQuery, model: str | None) -> SampleQuestion:
        if query.robot is None:
            query = replace(query, robot=self._robot)
        return SampleQuestion(shown(picture), model, query.robot, query)

    def _of_validity(self, picture: Picture, rows: ArrayLike, model: str | None) -> ValidityQuestion:
        return ValidityQuestion(shown(picture), model, self._robot, rows_of(rows))

    def _of_plan(self, picture: Picture, query: PlanQuery, model: str | None) -> PlanQuestion:
        return PlanQuestion(shown(picture), model, self._robot, query)

    def _of_belief(self, picture: Picture, model: str | None) -> BeliefQuestion:
        return BeliefQuestion(shown(picture), model, self._robot)

    def _of_doctor(self, picture: Picture, model: str | None) -> DoctorQuestion:
        return DoctorQuestion(shown(picture), model, self._robot)

    def _pause_s(self, failure: Failure, tried: int, began: float) -> float:
        """How long to wait before another attempt; raises the failure's error where there is none."""
        pause_s = failure.pause_s(self._endpoint.policy, tried, began)
        if pause_s is None:
            raise failure.error
        return pause_s


class SamplingClient(HttpClient[httpx.BaseTransport]):
    """Asks an inference API for samples, confidence and paths over one kept connection.

    Use it as a context manager, or close it. A request costs about 1 ms beside the server's work; never send
    one from a planner's callback, which would stop the search (and the interpreter) for as long. A lost
    connection, 503 and 429 are tried again; the seed, drawn here when none is given, makes that the same
    request.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``.
        timeout_s: for each read and write.
        connect_timeout_s: for connecting; ``timeout_s`` when None.
        policy: when a request is sent again; its deadline holds for connecting, sending and reading in all
            attempts together, whatever the time limits of their parts.
        api_key: sent as ``Authorization: Bearer``; None sends none.
        fallback: answers while the API stays away or its answers can not be used, with the same seed; the
            batch says so. The deadline does not hold for it.
        transport: of httpx; None for the network, where alone the deadline holds for every byte.
        robot: that is planned for, the digest that ``GET /models`` tells, where a query names none: samples
            of another one are refused. None takes those of any.

    Raises:
        ConfigError: the address, a time limit, the key or the robot can not be.
    """

    def sample(
        self,
        picture: Picture,
        n: int,
        seed: int | None = None,
        *,
        model: str | None = None,
        **options: Unpack[QueryOptions],
    ) -> SampleBatch:
        """One batch of at most ``n`` samples.

        Args:
            picture: of the scene.
            n: how many, 1 to ``MAX_SAMPLES``.
            seed: unsigned 64 bit; drawn here when None.
            model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the default.
            options: as :class:`cspace_client.SampleQuery` has them.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerError: likewise, or a value can not be sent.
        """
        return self.answer(picture, SampleQuery.of(n, seed, **options), model)

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """One batch of at most ``query.n`` samples.

        Args:
            picture: of the scene.
            query: what is asked, its values plain numbers.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: no connection, no answer in time, no model ready (503), too many requests
                (429), or a server that fails (5xx), and no fallback that answers.
            SamplerAnswerError: likewise, for an answer that can not be used.
            SamplerError: the request was refused (4xx).
        """
        began = time.perf_counter()
        question = self._of_samples(picture, query, model)
        try:
            return self._ask(question)
        except SamplerUnavailableError as error:
            if self._fallback is None:
                raise
            try:
                batch = self._fallback.answer(picture, question.query, model)
            except SamplerError as refusal:
                raise error from refusal
            return replace(batch, fallback=True, round_trip_s=time.perf_counter() - began)

    def validity(self, picture: Picture, configurations: ArrayLike, model: str | None = None) -> Predictions:
        """A model's confidence that configurations are free; no fallback answers.

        Args:
            picture: of the scene.
            configurations: (n, d) rad, at most ``MAX_SAMPLES``.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerAnswerError: likewise.
            SamplerError: likewise, or the configurations can not be asked about.
        """
        return self._ask(self._of_validity(picture, configurations, model))

    def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """A path from start to goal by what a model predicts for a picture; no fallback answers.

        The client's time limits have to leave room for that of the search.

        Args:
            picture: of the scene.
            query: the problem, a :class:`cspace_client.PlanQuery` for example; the server checks it.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it, or the server does not plan (501).
            SamplerAnswerError: likewise, for a path that does not lead from start to goal, for example.
            SamplerError: likewise.
        """
        return self._ask(self._of_plan(picture, query, model))

    def belief(self, picture: Picture, model: str | None = None) -> Belief:
        """What a model takes the whole scene of depth pictures to be, seen or not; no fallback answers.

        Args:
            picture: of the scene.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerAnswerError: likewise.
            SamplerError: likewise.
        """
        return self._ask(self._of_belief(picture, model))

    def doctor(self, picture: Picture, model: str | None = None) -> Diagnosis:
        """What is wrong with pictures, cameras and state, and what to do; no fallback answers.

        Args:
            picture: of the scene.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerAnswerError: likewise.
            SamplerError: likewise.
        """
        return self._ask(self._of_doctor(picture, model))

    def close(self) -> None:
        """Close the connection."""
        self._closed = True
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @staticmethod
    def _network() -> httpx.BaseTransport:
        return DeadlineTransport(LIMITS)

    def _ask(self, question: Question[Found]) -> Found:
        if self._closed:
            raise RuntimeError("the client is closed")
        began, tried = time.perf_counter(), 0
        while True:
            found = self._attempt(question, began)
            if not isinstance(found, Failure):
                return found
            tried += 1
            time.sleep(self._pause_s(found, tried, began))

    def _attempt(self, question: Question[Found], began: float) -> Found | Failure:
        request = self._endpoint.request(question, time.perf_counter() - began)
        until = began + self._endpoint.policy.deadline_s
        try:
            with deadline(until):
                answer = self._transport.handle_request(request)
                try:
                    incoming = IncomingAnswer(answer, question, until)
                    for chunk in cast("httpx.SyncByteStream", answer.stream):
                        incoming.take(chunk)
                    return incoming.conclude(time.perf_counter() - began)
                except SamplerAnswerError:
                    _hang_up(answer)
                    raise
                finally:
                    answer.close()
        except SamplerAnswerError as error:
            return Failure(error)
        except Exception as error:  # noqa: BLE001 - whatever a stranger's bytes bring out of the HTTP library
            return lost(error, self._endpoint)


def _hang_up(answer: httpx.Response) -> None:
    """Close the connection: an answer that was read whole would leave it to be used again."""
    if (stream := answer.extensions.get("network_stream")) is not None:
        stream.close()


class AsyncSamplingClient(HttpClient[httpx.AsyncBaseTransport]):
    """As :class:`cspace_client.SamplingClient`, awaited; tasks may share one.

    Args:
        url: as there, and so the rest.
        fallback: answers in a thread while the API stays away.
    """

    async def sample(
        self,
        picture: Picture,
        n: int,
        seed: int | None = None,
        *,
        model: str | None = None,
        **options: Unpack[QueryOptions],
    ) -> SampleBatch:
        """See :meth:`cspace_client.SamplingClient.sample`."""
        return await self.answer(picture, SampleQuery.of(n, seed, **options), model)

    async def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :meth:`cspace_client.SamplingClient.answer`.

        Raises:
            SamplerUnavailableError: as there.
            SamplerAnswerError: as there.
            SamplerError: as there.
        """
        began = time.perf_counter()
        question = self._of_samples(picture, query, model)
        try:
            return await self._ask(question)
        except SamplerUnavailableError as error:
            if self._fallback is None:
                raise
            try:
                batch = await anyio.to_thread.run_sync(self._fallback.answer, picture, question.query, model)
            except SamplerError as refusal:
                raise error from refusal
            return replace(batch, fallback=True, round_trip_s=time.perf_counter() - began)

    async def validity(
        self, picture: Picture, configurations: ArrayLike, model: str | None = None
    ) -> Predictions:
        """See :meth:`cspace_client.SamplingClient.validity`."""
        return await self._ask(self._of_validity(picture, configurations, model))

    async def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """See :meth:`cspace_client.SamplingClient.plan`."""
        return await self._ask(self._of_plan(picture, query, model))

    async def belief(self, picture: Picture, model: str | None = None) -> Belief:
        """See :meth:`cspace_client.SamplingClient.belief`."""
        return await self._ask(self._of_belief(picture, model))

    async def doctor(self, picture: Picture, model: str | None = None) -> Diagnosis:
        """See :meth:`cspace_client.SamplingClient.doctor`."""
        return await self._ask(self._of_doctor(picture, model))

    async def aclose(self) -> None:
        """Close the connections."""
        self._closed = True
        await self._transport.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()

    @staticmethod
    def _network() -> httpx.AsyncBaseTransport:
        return httpx.AsyncHTTPTransport(trust_env=False, limits=LIMITS)

    async def _ask(self, question: Question[Found]) -> Found:
        if self._closed:
            raise RuntimeError("the client is closed")
        began, tried = time.perf_counter(), 0
        while True:
            found = await self._attempt(question, began)
            if not isinstance(found, Failure):
                return found
            tried += 1
            await anyio.sleep(self._pause_s(found, tried, began))

    async def _attempt(self, question: Question[Found], began: float) -> Found | Failure:
        spent_s = time.perf_counter() - began
        request = self._endpoint.request(question, spent_s)
        try:
            with anyio.fail_after(self._endpoint.policy.deadline_s - spent_s):
                answer = await self._transport.handle_async_request(request)
                try:
                    incoming = IncomingAnswer(answer, question, began + self._endpoint.policy.deadline_s)
                    async for chunk in cast("httpx.AsyncByteStream", answer.stream):
                        incoming.take(chunk)
                    return incoming.conclude(time.perf_counter() - began)
                except SamplerAnswerError:
                    await _hang_up_async(answer)
                    raise
                finally:
                    await answer.aclose()
        except SamplerAnswerError as error:
            return Failure(error)
        except Exception as error:  # noqa: BLE001 - whatever a stranger's bytes bring out of the HTTP library
            return lost(error, self._endpoint)


async def _hang_up_async(answer: httpx.Response) -> None:
    """As the other client's."""
    if (stream := answer.extensions.get("network_stream")) is not None:
        await stream.aclose()
