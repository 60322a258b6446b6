"""Who computes and who waits."""

import asyncio
import threading
from collections.abc import Callable

import anyio
import pytest
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge
from starlette.requests import ClientDisconnect

from inference_api import scheduler as scheduler_module
from inference_api.problem_types import RequestError
from inference_api.scheduler import Job, Scheduler
from tests.inference_api.job_work import PATIENCE_S, Gate, leaving, until, value


@pytest.fixture
def waiting() -> Gauge:
    return Gauge("waiting", "Those that wait.", registry=CollectorRegistry())


def test_one_more_than_the_threads_waits_and_is_counted_until_its_turn(waiting: Gauge) -> None:
    open_gate, running = threading.Event(), threading.Semaphore(0)

    def work(job: Job) -> int:
        running.release()
        assert open_gate.wait(PATIENCE_S)
        return 7

    async def scenario() -> None:
        scheduler, found = Scheduler(2, waiting), []

        async def ask() -> None:
            found.append(await scheduler.run(work))

        async with anyio.create_task_group() as group:
            for _ in range(3):
                group.start_soon(ask)
            for _ in range(2):
                assert await to_thread.run_sync(lambda: running.acquire(timeout=PATIENCE_S))
            assert value(waiting) == 1
            open_gate.set()
        assert found == [7, 7, 7]
        assert value(waiting) == 0

    anyio.run(scenario)


@pytest.mark.parametrize("begun", [True, False])
def test_what_takes_too_long_is_refused_and_the_next_one_computed(waiting: Gauge, begun: bool) -> None:
    gate = Gate()

    def endless(job: Job) -> None:
        while True:
            job.check_cancelled()

    async def scenario() -> None:
        scheduler = Scheduler(1, waiting, answer_s=0.1)
        async with anyio.create_task_group() as group:
            if not begun:
                group.start_soon(scheduler.run, gate)
                await gate.is_at_work()
            with pytest.raises(RequestError, match="too busy") as refused:
                await scheduler.run(endless if begun else lambda job: 1)
            gate.open.set()
        assert refused.value.problem.status == 503
        assert value(waiting) == 0
        assert await scheduler.run(lambda job: "next") == "next"

    anyio.run(scenario)


def test_a_client_that_leaves_the_queue_is_never_computed_for(waiting: Gauge) -> None:
    gate, computed = Gate(), []

    async def scenario() -> None:
        scheduler, left = Scheduler(1, waiting), asyncio.Event()
        async with anyio.create_task_group() as group:
            group.start_soon(scheduler.run, gate)
            await gate.is_at_work()

            async def ask() -> None:
                with pytest.raises(ClientDisconnect):
                    await scheduler.run(lambda job: computed.append(1), "gone", leaving(left))

            group.start_soon(ask)
            await until(lambda: value(waiting) == 1)
            left.set()
            await until(lambda: value(waiting) == 0)
            gate.open.set()
        assert await scheduler.run(lambda job: "next") == "next"

    anyio.run(scenario)
    assert computed == []


def test_a_client_that_leaves_when_it_is_called_and_before_its_thread_begins_leaves_its_place(
    waiting: Gauge,
) -> None:
    gate, computed = Gate(), []

    async def scenario() -> None:
        scheduler = Scheduler(1, waiting)
        clients: list[Callable[[], None]] = []

        def watch(leave: Callable[[], None]) -> Callable[[], None]:
            clients.append(leave)
            return lambda: None

        async def ask() -> None:
            with pytest.raises(ClientDisconnect):
                await scheduler.run(lambda job: computed.append(1), "gone", watch)

        async with anyio.create_task_group() as group:
            group.start_soon(scheduler.run, gate)
            await gate.is_at_work()
            group.start_soon(ask)
            await until(lambda: value(waiting) == 1)
            first = next(iter(scheduler._running))
            # In one step of the loop: the place is free, the next one is called, and goes.
            scheduler.leave(first)
            clients[0]()
            gate.open.set()
        with anyio.fail_after(PATIENCE_S):
            assert await scheduler.run(lambda job: "next") == "next"
        assert not scheduler._running

    anyio.run(scenario)
    assert computed == []


def test_one_that_is_cancelled_keeps_its_place_until_its_thread_ends(waiting: Gauge) -> None:
    gate = Gate()

    async def scenario() -> None:
        scheduler = Scheduler(1, waiting)
        async with anyio.create_task_group() as cancelled:
            cancelled.start_soon(scheduler.run, gate)
            await gate.is_at_work()
            cancelled.cancel_scope.cancel()
        async with anyio.create_task_group() as group:
            group.start_soon(scheduler.run, lambda job: None)
            await until(lambda: value(waiting) == 1)
            gate.open.set()
        assert value(waiting) == 0

    anyio.run(scenario)


def test_a_stint_without_an_end_is_noticed(waiting: Gauge, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate()

    async def scenario() -> None:
        scheduler = Scheduler(1, waiting)
        async with anyio.create_task_group() as group:
            group.start_soon(scheduler.run, gate)
            await gate.is_at_work()
            assert not scheduler.is_stuck
            monkeypatch.setattr(scheduler_module, "STUCK_S", 0.0)
            await until(lambda: scheduler.is_stuck)
            gate.open.set()
        assert not scheduler.is_stuck

    anyio.run(scenario)
