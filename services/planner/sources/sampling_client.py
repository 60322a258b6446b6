"""The client of an inference API as a source of samples: ``cspace_client``'s, behind the project's port."""

from typing import Generic, Self, TypedDict, TypeVar, Unpack

import httpx
from numpy.typing import ArrayLike

import cspace_client
from cspace.query import PlanQuery, SampleQuery
from cspace_client import DEFAULT_TIMEOUT_S, Beliefs, RetryPolicy
from services.planner.sources.client_errors import mapped
from services.planner.sources.client_source import ClientSource
from services.planner.sources.found_plan import FoundPlan, found_plan
from services.planner.sources.samples import Picture, SampleBatch, SampleSource

__all__ = [
    "DEFAULT_TIMEOUT_S",
    "Beliefs",
    "ClientOptions",
    "FoundPlan",
    "RetryPolicy",
    "SampleBatch",
    "SamplingClient",
    "stand_in",
]

Transport = TypeVar("Transport", httpx.BaseTransport, httpx.AsyncBaseTransport)


class ClientOptions(TypedDict, Generic[Transport], total=False):
    """What a client may be given beside the address, as :class:`cspace_client.SamplingClient` has it.

    Its ``robot`` is what :func:`cspace.worlds.robot_digest` names.
    """

    connect_timeout_s: float | None
    policy: RetryPolicy
    api_key: str | None
    transport: Transport | None
    robot: str | None


class SamplingClient(SampleSource):
    """Asks an inference API for samples, beliefs and ways over one kept connection.

    Args:
        url: as :class:`cspace_client.SamplingClient` has it, and so the rest.
        timeout_s: likewise.
        fallback: answers while the API stays away or its answers can not be used, with the same seed; the
            batch says so. The deadline does not hold for it.
        options: likewise.

    Raises:
        ConfigError: the address, a time limit, the key or the robot can not be.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        *,
        fallback: SampleSource | None = None,
        **options: Unpack[ClientOptions[httpx.BaseTransport]],
    ) -> None:
        with mapped():
            self._client = cspace_client.SamplingClient(
                url, timeout_s, fallback=stand_in(fallback), **options
            )

    @property
    def url(self) -> str:
        """Of the API, without a slash at its end."""
        return self._client.url

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        """See :class:`services.planner.sources.samples.SampleSource`.

        Raises:
            SamplerUnavailableError: no connection, no answer in time, no model ready (503), too many requests
                (429), or a server that fails (5xx), and no fallback that answers.
            SamplerAnswerError: likewise, for an answer that can not be used.
            SamplerError: the request was refused (4xx).
        """
        with mapped():
            return self._client.answer(picture, query, model)

    def validity(self, picture: Picture, configurations: ArrayLike, model: str | None = None) -> Beliefs:
        """How sure a model is that configurations are free; no fallback answers.

        Args:
            picture: of the scenario; of depth cameras a file of :func:`cspace.view_file.pack_view`.
            configurations: (n, d) rad, at most ``MAX_SAMPLES``.
            model: as :meth:`answer` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerAnswerError: likewise.
            SamplerError: likewise, or the configurations can not be asked about.
        """
        with mapped():
            return self._client.validity(picture, configurations, model)

    def plan(self, picture: Picture, query: PlanQuery, model: str | None = None) -> FoundPlan:
        """A way from start to goal in what a model believes of a picture; no fallback answers.

        The client's time limits have to leave room for that of the search.

        Args:
            picture: as :meth:`validity` has it.
            query: the problem; the server judges it.
            model: as :meth:`answer` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it, or the server does not plan (501).
            SamplerAnswerError: likewise, for a way that does not lead from start to goal, for example.
            SamplerError: likewise.
        """
        with mapped():
            return found_plan(self._client.plan(picture, query, model))

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def stand_in(source: SampleSource | None) -> ClientSource | None:
    """A source as the client's fallback."""
    return None if source is None else ClientSource(source)
