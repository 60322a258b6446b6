"""A light load of requests for samples beside a test, every one of them remembered."""

import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import httpx

from tests.compose.answers import request
from tests.compose.stack import Stack

PAUSE_S = 0.1
LIMIT_S = 300.0


@dataclass(frozen=True)
class Attempt:
    """One request: when it was sent and answered, by the monotonic clock, and what went wrong."""

    sent_s: float
    answered_s: float
    fault: str | None


class Load:
    """One client that asks for samples again and again while the block runs."""

    def __init__(self, stack: Stack) -> None:
        self.attempts: list[Attempt] = []
        self._url = f"{stack.url('API')}/sample"
        self._request = request()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="load")

    @property
    def faults(self) -> list[Attempt]:
        """Attempts that got no samples."""
        return [attempt for attempt in self.attempts if attempt.fault is not None]

    def more_answers(self, count: int = 20) -> None:
        """Wait until so many further requests were answered well."""
        until = time.monotonic() + LIMIT_S
        enough = self._answered() + count
        while self._answered() < enough:
            assert time.monotonic() < until, f"{self._answered()} of {enough}; {self.faults[-3:]}"
            time.sleep(PAUSE_S)

    def a_fault(self) -> None:
        """Wait until a request failed."""
        until = time.monotonic() + LIMIT_S
        while not self.faults:
            assert time.monotonic() < until, "no request has failed"
            time.sleep(PAUSE_S)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _answered(self) -> int:
        return len(self.attempts) - len(self.faults)

    def _run(self) -> None:
        while not self._ended.wait(PAUSE_S):
            sent_s = time.monotonic()
            fault = self._ask()
            self.attempts.append(Attempt(sent_s, time.monotonic(), fault))

    def _ask(self) -> str | None:
        # A connection of its own for each request: one that is kept would hide a listener that went away.
        try:
            answer = httpx.post(self._url, timeout=30, **self._request)
        except httpx.HTTPError as error:
            return repr(error)
        return None if answer.status_code == 200 else f"{answer.status_code} {answer.text}"
