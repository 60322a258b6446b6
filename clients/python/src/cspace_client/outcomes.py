"""Reports to a server what became of its answers, from a thread of its own."""

import queue
import time
from contextlib import suppress
from threading import Event, Lock, Thread
from typing import Any, Self

import httpx

from cspace_client.answers import FoundPlan, SampleBatch
from cspace_client.wire import MAX_OUTCOMES, OutcomesRequest, PlanOutcome, SamplesOutcome

MAX_WAITING = 10_000
"""Outcomes that wait to be sent."""
Outcome = PlanOutcome | SamplesOutcome
EVERY_S, CLOSE_S, ATTEMPTS = 1.0, 5.0, 4


class OutcomeSender:
    """Sends outcomes in batches in the background; a context manager.

    Neither :meth:`plan` nor :meth:`samples` waits. What cannot be sent is dropped and counted. Answers
    without a request id are ignored. Wrong values are a ``pydantic.ValidationError``.
    """

    def __init__(
        self, url: str, *, api_key: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        headers = {} if api_key is None else {"Authorization": f"Bearer {api_key}"}
        network = transport or httpx.HTTPTransport(retries=1)
        self._http = httpx.Client(base_url=url, headers=headers, transport=network, trust_env=False)
        self._queue: queue.Queue[Outcome] = queue.Queue(MAX_WAITING)
        self._lock, self._closing = Lock(), Event()
        self.sent = 0
        """Outcomes that the server took."""
        self.dropped = 0
        """Outcomes that were not sent: too many waited, or the server refused them or was away."""
        self._thread = Thread(target=self._run, name="outcomes", daemon=True)
        self._thread.start()

    def plan(self, found: FoundPlan, *, success: bool, **known: Any) -> None:
        """Reports what became of a plan, after its execution or an exact check.

        ``success`` says whether its path was free, or was executed to its end. What is known beside it:
        ``executed``, ``collided``, ``collided_at``, ``time_s`` and ``site``, as
        :class:`cspace_client.wire.PlanOutcome` has them.
        """
        model, novelty = f"{found.model.name}/{found.model.version}", found.scenario.novelty
        told = {"confidence": found.confidence, "receipt": found.receipt, "success": success, **known}
        self._put(PlanOutcome, found.request_id, model, novelty, told)

    def samples(self, batch: SampleBatch, *, checked: int, free: int, site: str | None = None) -> None:
        """Reports how many samples were checked exactly, and how many of those were free."""
        model, told = f"{batch.model_name}/{batch.model_version}", {"checked": checked, "free": free}
        self._put(SamplesOutcome, batch.request_id, model, batch.novelty, {**told, "site": site})

    def close(self) -> None:
        """Sends what waits, and returns after 5 s at the latest."""
        with self._lock:
            self._closing.set()
        self._thread.join(CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _put(
        self,
        kind: type[Outcome],
        request_id: str | None,
        model: str,
        novelty: float | None,
        told: dict[str, Any],
    ) -> None:
        if request_id is None:
            return
        outcome = kind(request_id=request_id, model=model, novelty=novelty, stamp_s=time.time(), **told)
        # Under the lock, or what comes while this is closed would be neither sent nor counted.
        with self._lock:
            if not self._closing.is_set():
                with suppress(queue.Full):
                    self._queue.put_nowait(outcome)
                    return
            self.dropped += 1

    def _run(self) -> None:
        with self._http:
            while not self._closing.wait(EVERY_S):
                self._drain()
            self._drain()

    def _drain(self) -> None:
        while batch := self._take():
            took = self._deliver(batch)
            with self._lock:
                self.sent += len(batch) if took else 0
                self.dropped += 0 if took else len(batch)

    def _take(self) -> list[Outcome]:
        batch: list[Outcome] = []
        with suppress(queue.Empty):
            while len(batch) < MAX_OUTCOMES:
                batch.append(self._queue.get_nowait())
        return batch

    def _deliver(self, batch: list[Outcome]) -> bool:
        """Whether the server took a batch. It may get it twice: it counts an outcome once."""
        content = OutcomesRequest(outcomes=batch).model_dump_json(exclude_none=True)
        headers = {"Content-Type": "application/json"}
        for attempt in range(ATTEMPTS):
            # Who closes this waits for answers, not for pauses.
            self._closing.wait(0.5 * (2**attempt - 1))
            with suppress(httpx.TransportError):
                status = self._http.post(
                    "/outcomes", content=content, headers=headers, timeout=10.0
                ).status_code
                if status == httpx.codes.ACCEPTED:
                    return True
                if status < httpx.codes.INTERNAL_SERVER_ERROR and status != httpx.codes.TOO_MANY_REQUESTS:
                    return False
        return False
