"""The client of an inference API: ``POST /sample``, ``/validity`` and ``/plan``."""

import time
from dataclasses import replace
from typing import Self, Unpack, cast

import httpx
from numpy.typing import ArrayLike

from cspace_client.errors import SamplerAnswerError, SamplerError, SamplerUnavailableError
from cspace_client.http.answer import Failure, IncomingAnswer, lost
from cspace_client.http.client import HttpClient
from cspace_client.http.deadline_transport import DeadlineTransport, deadline
from cspace_client.http.endpoint import LIMITS
from cspace_client.pictures import Picture
from cspace_client.plans import FoundPlan, PlanWanted
from cspace_client.questions.question import Found, Question
from cspace_client.questions.validity_question import Beliefs
from cspace_client.samples import QueryOptions, SampleBatch, SampleQuery, Wanted


class SamplingClient(HttpClient[httpx.BaseTransport]):
    """Asks an inference API for samples, beliefs and ways over one kept connection.

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

    def answer(self, picture: Picture, query: Wanted, model: str | None = None) -> SampleBatch:
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
            return self._ask(question, began)
        except SamplerUnavailableError as error:
            if self._fallback is None:
                raise
            try:
                batch = self._fallback.answer(picture, question.query, model)
            except SamplerError as refusal:
                raise error from refusal
            return replace(batch, fallback=True, round_trip_s=time.perf_counter() - began)

    def validity(self, picture: Picture, configurations: ArrayLike, model: str | None = None) -> Beliefs:
        """How sure a model is that configurations are free; no fallback answers.

        Args:
            picture: of the scene.
            configurations: (n, d) rad, at most ``MAX_SAMPLES``.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it.
            SamplerAnswerError: likewise.
            SamplerError: likewise, or the configurations can not be asked about.
        """
        return self._ask(self._of_validity(picture, configurations, model), time.perf_counter())

    def plan(self, picture: Picture, query: PlanWanted, model: str | None = None) -> FoundPlan:
        """A way from start to goal in what a model believes of a picture; no fallback answers.

        The client's time limits have to leave room for that of the search.

        Args:
            picture: of the scene.
            query: the problem, a :class:`cspace_client.PlanQuery` for example; the server judges it.
            model: as :meth:`sample` has it.

        Raises:
            SamplerUnavailableError: as :meth:`answer` has it, or the server does not plan (501).
            SamplerAnswerError: likewise, for a way that does not lead from start to goal, for example.
            SamplerError: likewise.
        """
        return self._ask(self._of_plan(picture, query, model), time.perf_counter())

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

    def _ask(self, question: Question[Found], began: float) -> Found:
        if self._closed:
            raise RuntimeError("the client is closed")
        tried = 0
        while True:
            found = self._attempt(question, began)
            if not isinstance(found, Failure):
                return found
            if (untold := self._untold(question, found)) is not None:
                question = untold
                continue
            tried += 1
            time.sleep(self._pause_s(found, tried, began))

    def _attempt(self, question: Question[Found], began: float) -> Found | Failure:
        request = self._endpoint.request(question, time.perf_counter() - began)
        until = began + self._endpoint.policy.deadline_s
        try:
            with deadline(until):
                answer = self._transport.handle_request(request)
                try:
                    return self._read(answer, question, began, until)
                except SamplerAnswerError:
                    _hang_up(answer)
                    raise
                finally:
                    answer.close()
        except SamplerAnswerError as error:
            return Failure(error)
        except Exception as error:  # noqa: BLE001 - whatever a stranger's bytes bring out of the HTTP library
            return lost(error, self._endpoint)

    @staticmethod
    def _read(
        answer: httpx.Response, question: Question[Found], began: float, until: float
    ) -> Found | Failure:
        incoming = IncomingAnswer(answer, question, until)
        for chunk in cast("httpx.SyncByteStream", answer.stream):
            incoming.take(chunk)
        return incoming.conclude(time.perf_counter() - began)


def _hang_up(answer: httpx.Response) -> None:
    """Close the connection: an answer that was read whole would leave it to be used again."""
    if (stream := answer.extensions.get("network_stream")) is not None:
        stream.close()
