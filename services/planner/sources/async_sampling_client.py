"""The awaited client of an inference API, for asyncio's event loops and trio's, with the project's errors."""

from collections.abc import Coroutine
from typing import Any, Self, Unpack

import httpx
from numpy.typing import ArrayLike

import cspace_client
from cspace.query import PlanQuery, SampleQuery
from services.planner.sources.client_errors import mapped
from services.planner.sources.found_plan import FoundPlan, found_plan
from services.planner.sources.samples import Answering, Picture, SampleBatch, SampleSource
from services.planner.sources.sampling_client import DEFAULT_TIMEOUT_S, Beliefs, ClientOptions, stand_in


class AsyncSamplingClient(Answering[Coroutine[Any, Any, SampleBatch]]):
    """As :class:`services.planner.sources.sampling_client.SamplingClient`, awaited; tasks may share one.

    Args:
        url: as there, and so the rest.
        timeout_s: likewise.
        fallback: answers in a thread while the API stays away.
        options: likewise.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        fallback: SampleSource | None = None,
        **options: Unpack[ClientOptions[httpx.AsyncBaseTransport]],
    ) -> None:
        with mapped():
            self._client = cspace_client.AsyncSamplingClient(
                url, timeout_s, fallback=stand_in(fallback), **options
            )

    async def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :meth:`services.planner.sources.sampling_client.SamplingClient.answer`.

        Raises:
            SamplerUnavailableError: as there.
            SamplerAnswerError: as there.
            SamplerError: as there.
        """
        with mapped():
            return await self._client.answer(picture, query, model)

    async def validity(
        self, picture: Picture, configurations: ArrayLike, model: str | None = None
    ) -> Beliefs:
        """See :meth:`services.planner.sources.sampling_client.SamplingClient.validity`."""
        with mapped():
            return await self._client.validity(picture, configurations, model)

    async def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """See :meth:`services.planner.sources.sampling_client.SamplingClient.plan`."""
        with mapped():
            return found_plan(await self._client.plan(picture, query, model))

    async def aclose(self) -> None:
        """Close the connections."""
        await self._client.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()
