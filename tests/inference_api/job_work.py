"""Work and clients for tests of scheduler."""

import asyncio
import threading
from collections.abc import Callable
from itertools import count

import anyio
import pytest
from anyio import to_thread
from prometheus_client import Gauge

from inference_api.scheduler import LONG_ROWS, ROWS_A_SECOND, STINT_S, YOUNG_ROWS, Job, Watch

PATIENCE_S = 20.0
LONG = 2 * LONG_ROWS
# So many stints, and a request is not young any more.
YOUNG_STINTS = int(YOUNG_ROWS / ROWS_A_SECOND / STINT_S) + 1


def ticking() -> Callable[[], float]:
    """A clock by which every pause ends a stint."""
    ticks = count()
    return lambda: 1.01 * STINT_S * next(ticks)


def value(gauge: Gauge) -> float:
    (family,) = gauge.collect()
    return family.samples[0].value


async def until(condition: Callable[[], bool]) -> None:
    with anyio.fail_after(PATIENCE_S):
        while not condition():
            await anyio.sleep(0.005)


def watched_jobs(monkeypatch: pytest.MonkeyPatch) -> tuple[Callable[[], bool], Callable[[], int]]:
    """Whether a request was announced as long, and how often others might have had its job."""
    rows: list[float] = []
    parts: list[Job] = []
    spend, check_cancelled = Job.spend, Job.check_cancelled

    def spending(job: Job, more: float) -> None:
        rows.append(more)
        spend(job, more)

    def counted(job: Job) -> None:
        parts.append(job)
        check_cancelled(job)

    monkeypatch.setattr(Job, "spend", spending)
    monkeypatch.setattr(Job, "check_cancelled", counted)
    return lambda: sum(rows) > LONG_ROWS, lambda: len(parts)


class Gate:
    """Work that says that it runs, and goes on when it is told."""

    def __init__(self) -> None:
        self.runs, self.open = threading.Event(), threading.Event()

    def __call__(self, job: Job) -> int:
        self.runs.set()
        assert self.open.wait(PATIENCE_S)
        return 7

    async def is_at_work(self) -> None:
        assert await to_thread.run_sync(self.runs.wait, PATIENCE_S)


def leaving(after: asyncio.Event) -> Watch:
    """A client that goes away when an event comes."""

    def watch(leave: Callable[[], None]) -> Callable[[], None]:
        async def wait() -> None:
            await after.wait()
            leave()

        return asyncio.ensure_future(wait()).cancel

    return watch
