"""The client of an inference API for programs with an event loop, asyncio's or trio's."""

import time
from dataclasses import replace
from typing import Self, Unpack, cast

import anyio
import anyio.to_thread
import httpx
from numpy.typing import ArrayLike

from cspace_client.errors import SamplerAnswerError, SamplerError, SamplerUnavailableError
from cspace_client.http.answer import Failure, IncomingAnswer, lost
from cspace_client.http.client import HttpClient
from cspace_client.http.endpoint import LIMITS
from cspace_client.pictures import Picture
from cspace_client.plans import FoundPlan, PlanWanted
from cspace_client.questions.question import Found, Question
from cspace_client.questions.validity_question import Beliefs
from cspace_client.samples import QueryOptions, SampleBatch, SampleQuery, Wanted


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

    async def answer(self, picture: Picture, query: Wanted, model: str | None = None) -> SampleBatch:
        """See :meth:`cspace_client.SamplingClient.answer`.

        Raises:
            SamplerUnavailableError: as there.
            SamplerAnswerError: as there.
            SamplerError: as there.
        """
        began = time.perf_counter()
        question = self._of_samples(picture, query, model)
        try:
            return await self._ask(question, began)
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
    ) -> Beliefs:
        """See :meth:`cspace_client.SamplingClient.validity`."""
        return await self._ask(self._of_validity(picture, configurations, model), time.perf_counter())

    async def plan(self, picture: Picture, query: PlanWanted, model: str | None = None) -> FoundPlan:
        """See :meth:`cspace_client.SamplingClient.plan`."""
        return await self._ask(self._of_plan(picture, query, model), time.perf_counter())

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

    async def _ask(self, question: Question[Found], began: float) -> Found:
        if self._closed:
            raise RuntimeError("the client is closed")
        tried = 0
        while True:
            found = await self._attempt(question, began)
            if not isinstance(found, Failure):
                return found
            if (untold := self._untold(question, found)) is not None:
                question = untold
                continue
            tried += 1
            await anyio.sleep(self._pause_s(found, tried, began))

    async def _attempt(self, question: Question[Found], began: float) -> Found | Failure:
        spent_s = time.perf_counter() - began
        request = self._endpoint.request(question, spent_s)
        try:
            with anyio.fail_after(self._endpoint.policy.deadline_s - spent_s):
                answer = await self._transport.handle_async_request(request)
                try:
                    return await self._read(answer, question, began)
                except SamplerAnswerError:
                    await _hang_up(answer)
                    raise
                finally:
                    await answer.aclose()
        except SamplerAnswerError as error:
            return Failure(error)
        except Exception as error:  # noqa: BLE001 - whatever a stranger's bytes bring out of the HTTP library
            return lost(error, self._endpoint)

    async def _read(self, answer: httpx.Response, question: Question[Found], began: float) -> Found | Failure:
        incoming = IncomingAnswer(answer, question, began + self._endpoint.policy.deadline_s)
        async for chunk in cast("httpx.AsyncByteStream", answer.stream):
            incoming.take(chunk)
        return incoming.conclude(time.perf_counter() - began)


async def _hang_up(answer: httpx.Response) -> None:
    """As the other client's."""
    if (stream := answer.extensions.get("network_stream")) is not None:
        await stream.aclose()
