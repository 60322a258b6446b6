"""Reports to a server what became of its answers, from a thread of its own."""

import math
import queue
import re
import time
from contextlib import suppress
from dataclasses import replace
from threading import Event, Lock, Thread
from typing import Any, Self

import httpx
import numpy as np

from cspace_client.errors import SamplerError
from cspace_client.models import MAX_SAMPLES, FoundPlan, ModelHead, SampleBatch
from cspace_client.transport import (
    LIMITS,
    DeadlineTransport,
    Endpoint,
    Failure,
    RetryPolicy,
    deadline,
    failure_of,
    lost,
)

MAX_BATCH, MAX_WAITING = 1000, 10_000
"""Outcomes of one request, and those that wait to be sent."""
EVERY_S, CLOSE_S = 1.0, 5.0
_POLICY = RetryPolicy(attempts=6, cap_s=5.0)
_SITE = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)


class OutcomeSender:
    """Sends outcomes in batches in the background.

    Neither :meth:`plan` nor :meth:`samples` waits. They raise SamplerError for values that no server takes;
    what cannot be sent later is dropped and counted. Answers without a request id, as of a fallback, are
    ignored. Use it as a context manager, or close it.

    Args:
        url: of the API.
        api_key: sent as ``Authorization: Bearer``; None sends none.
        transport: of httpx; None for the network.

    Raises:
        ConfigError: the address or the key can not be.
    """

    def __init__(
        self, url: str, *, api_key: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        self._endpoint = Endpoint(url, 10.0, None, _POLICY, api_key)
        self._transport = DeadlineTransport(LIMITS) if transport is None else transport
        self._queue: queue.Queue[dict[str, Any]] = queue.Queue(MAX_WAITING)
        self._lock, self._closing = Lock(), Event()
        self._sent, self._dropped = 0, 0
        self._thread = Thread(target=self._run, name="outcomes", daemon=True)
        self._thread.start()

    @property
    def sent(self) -> int:
        """Outcomes that the server took."""
        return self._sent

    @property
    def dropped(self) -> int:
        """Outcomes that were not sent: too many waited, or the server refused them or stayed away."""
        return self._dropped

    def plan(
        self,
        found: FoundPlan,
        *,
        success: bool,
        executed: bool | None = None,
        collided: bool | None = None,
        collided_at: float | None = None,
        time_s: float | None = None,
        site: str | None = None,
    ) -> None:
        """Reports what became of a plan; None is not known.

        Args:
            found: the answer.
            success: whether it served its purpose: its path was free, or was executed to its end.
            executed: whether a robot moved along the path.
            collided: whether the path collides, in the world or for an exact check.
            collided_at: where it collides first, as a share of its length.
            time_s: from the request to this outcome, s.
            site: a name of the place: letters, digits, dots, dashes and underscores.

        Raises:
            SamplerError: a value can not be sent.
        """
        _require(collided_at is None or (collided and 0.0 <= collided_at <= 1.0), "collided_at", collided_at)
        _require(time_s is None or 0.0 <= time_s < math.inf, "time_s", time_s)
        known = {
            "executed": executed,
            "collided": collided,
            "collided_at": collided_at,
            "time_s": time_s,
            "calibration": found.calibration,
        }
        self._put(
            found.request_id,
            found.model,
            {"kind": "plan", "success": success, "confidence": found.plan.confidence, "site": site, **known},
        )

    def samples(self, batch: SampleBatch, *, checked: int, free: int, site: str | None = None) -> None:
        """Reports what exact checks found of samples.

        Args:
            batch: the answer.
            checked: how many were checked.
            free: how many of those were free.
            site: as in :meth:`plan`.

        Raises:
            SamplerError: a value can not be sent.
        """
        _require(0 <= free <= checked <= MAX_SAMPLES, "free", f"{free} of {checked}")
        self._put(
            batch.request_id,
            batch,
            {"kind": "samples", "checked": checked, "free": free, "site": site},
        )

    def close(self) -> None:
        """Sends what waits, and returns after 5 s at the latest."""
        with self._lock:
            self._closing.set()
        self._thread.join(CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _put(self, request_id: str | None, head: ModelHead | SampleBatch, values: dict[str, Any]) -> None:
        site = values["site"]
        _require(site is None or _SITE.fullmatch(site), "site", site)
        if request_id is None:
            return
        model = f"{head.model_name}/{head.model_version}"
        known = {"request_id": request_id, "model": model, "novelty": head.novelty, "stamp_s": time.time()}
        # JSON takes none of NumPy's numbers.
        outcome = {
            name: value.item() if isinstance(value, np.generic) else value
            for name, value in {**known, **values}.items()
            if value is not None
        }
        # Under the lock, or what comes while this is closed would be neither sent nor counted.
        with self._lock:
            if not self._closing.is_set():
                with suppress(queue.Full):
                    self._queue.put_nowait(outcome)
                    return
            self._dropped += 1

    def _run(self) -> None:
        with self._transport:
            while not self._closing.wait(EVERY_S):
                self._drain()
            self._drain()

    def _drain(self) -> None:
        while batch := self._take():
            took = self._deliver(batch)
            with self._lock:
                self._sent += len(batch) if took else 0
                self._dropped += 0 if took else len(batch)

    def _take(self) -> list[dict[str, Any]]:
        batch: list[dict[str, Any]] = []
        with suppress(queue.Empty):
            while len(batch) < MAX_BATCH:
                batch.append(self._queue.get_nowait())
        return batch

    def _deliver(self, batch: list[dict[str, Any]]) -> bool:
        """Whether the server took a batch, which it may get twice: it counts an outcome once."""
        began, tried = time.perf_counter(), 0
        while (failure := self._post(batch, began)) is not None:
            tried += 1
            if (pause_s := failure.pause_s(_POLICY, tried, began)) is None:
                return False
            # Who closes this waits for answers, not for pauses.
            self._closing.wait(pause_s)
        return True

    def _post(self, batch: list[dict[str, Any]], began: float) -> Failure | None:
        """None where the server took it. Its words are not read, for nobody would see them."""
        try:
            spent_s = time.perf_counter() - began
            request = self._endpoint.post("/outcomes", spent_s, json={"outcomes": batch})
            with deadline(began + _POLICY.deadline_s):
                answer = self._transport.handle_request(request)
                answer.close()
        except Exception as error:  # noqa: BLE001 - whatever a stranger's bytes bring out of the HTTP library
            return replace(lost(error, self._endpoint), again=True)
        return None if answer.status_code == httpx.codes.ACCEPTED else failure_of(answer, b"")


def _require(fits: object, name: str, got: object) -> None:
    if not fits:
        raise SamplerError(
            "the outcome cannot be sent",
            expected="shares from 0 to 1, no more free than checked, and a short name as the site",
            got=f"{name}: {got!r}"[:200],
        )
