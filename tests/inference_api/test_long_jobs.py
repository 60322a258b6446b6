"""Requests that take long: in stints, few at once, beside short ones."""

import asyncio
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import anyio
import pytest
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge
from starlette.requests import ClientDisconnect

from inference_api.scheduler import LONG_AT_ONCE, LONG_OF_CLIENT, Job, Scheduler
from tests.inference_api.job_work import LONG, PATIENCE_S, YOUNG_STINTS, leaving, ticking, until, value


@pytest.fixture
def waiting() -> Gauge:
    return Gauge("waiting", "Those that wait.", registry=CollectorRegistry())


@pytest.mark.parametrize(("threads", "announced"), [(1, LONG), (2, 0)], ids=["a long one", "one alone"])
def test_a_request_whose_client_leaves_ends_at_its_next_pause(
    waiting: Gauge, threads: int, announced: float
) -> None:
    begun, stints = threading.Event(), []

    def work(job: Job) -> None:
        job.spend(announced)
        for number in range(10_000):
            begun.set()
            stints.append(number)
            time.sleep(0.001)
            job.check_cancelled()

    async def scenario() -> None:
        scheduler, left = Scheduler(threads, waiting, ticking()), asyncio.Event()
        async with anyio.create_task_group() as group:

            async def ask() -> None:
                with pytest.raises(ClientDisconnect):
                    await scheduler.run(work, "gone", leaving(left))

            group.start_soon(ask)
            assert await to_thread.run_sync(begun.wait, PATIENCE_S)
            left.set()
        assert await scheduler.run(lambda job: "next") == "next"

    anyio.run(scenario)
    assert len(stints) < 5000


@pytest.mark.parametrize("threads", [1, 2])
def test_a_short_request_does_not_wait_for_the_end_of_long_ones(waiting: Gauge, threads: int) -> None:
    begun, done = threading.Semaphore(0), threading.Event()

    def work(job: Job) -> str:
        job.spend(LONG)
        begun.release()
        while not done.is_set():
            time.sleep(0.001)
            job.check_cancelled()
        return "long"

    async def scenario() -> None:
        scheduler, found = Scheduler(threads, waiting, ticking()), []

        async def ask() -> None:
            found.append(await scheduler.run(work, "greedy"))

        async with anyio.create_task_group() as group:
            for _ in range(3):
                group.start_soon(ask)
            assert await to_thread.run_sync(lambda: begun.acquire(timeout=PATIENCE_S))
            with anyio.fail_after(PATIENCE_S):
                for _ in range(5):
                    assert await scheduler.run(lambda job: "short", "other") == "short"
            done.set()
        assert found == ["long"] * 3

    anyio.run(scenario)


def test_a_free_place_that_long_requests_may_not_take_is_taken_at_once(waiting: Gauge) -> None:
    begun, done = threading.Semaphore(0), threading.Event()

    def work(job: Job) -> None:
        job.spend(LONG)
        begun.release()
        assert done.wait(PATIENCE_S)

    async def scenario() -> None:
        scheduler = Scheduler(2, waiting, ticking())
        async with anyio.create_task_group() as group:
            for _ in range(2):
                group.start_soon(scheduler.run, work, "greedy")
            assert await to_thread.run_sync(lambda: begun.acquire(timeout=PATIENCE_S))
            await until(lambda: value(waiting) == 1)
            with anyio.fail_after(PATIENCE_S):
                # The long one that runs comes to no pause, and the other one may not run beside it.
                assert await scheduler.run(lambda job: "short", "other") == "short"
            done.set()

    anyio.run(scenario)


def test_few_long_requests_of_a_client_are_under_way_at_once(waiting: Gauge) -> None:
    under_way, most = set(), []

    def work(job: Job) -> None:
        job.spend(LONG)
        under_way.add(job)
        most.append(sum(other.client == job.client for other in under_way))
        for _ in range(5):
            time.sleep(0.001)
            job.check_cancelled()
        under_way.discard(job)

    async def scenario() -> None:
        scheduler = Scheduler(3, waiting, ticking())
        async with anyio.create_task_group() as group:
            for number in range(12):
                group.start_soon(scheduler.run, work, f"client {number % 2}")

    anyio.run(scenario)
    assert max(most) == LONG_OF_CLIENT


class Busy:
    """Long work without an end, of which stints are counted by client."""

    def __init__(self) -> None:
        self.stints: Counter[str] = Counter()
        self.done = threading.Event()

    def __call__(self, job: Job) -> None:
        job.spend(LONG)
        while not self.done.is_set():
            self.stints[job.client] += 1
            time.sleep(0.0005)
            job.check_cancelled()


@asynccontextmanager
async def busy_with(scheduler: Scheduler, busy: Busy, requests: int, clients: int) -> AsyncIterator[None]:
    """So many requests of so many clients, all of which have begun and are not young any more."""
    async with anyio.create_task_group() as group:
        for number in range(requests):
            group.start_soon(scheduler.run, busy, f"busy {number % clients}")
        most = min(requests, LONG_AT_ONCE)
        await until(lambda: sum(busy.stints.values()) > most * YOUNG_STINTS)
        with anyio.fail_after(PATIENCE_S):
            yield
        busy.done.set()


def test_a_client_whose_many_addresses_fill_all_places_of_long_requests_locks_nobody_out(
    waiting: Gauge,
) -> None:
    async def scenario() -> None:
        scheduler, busy = Scheduler(2, waiting, ticking()), Busy()
        async with busy_with(scheduler, busy, 2 * LONG_AT_ONCE, LONG_AT_ONCE):

            def work(job: Job) -> str:
                job.spend(LONG)
                job.check_cancelled()
                return "long"

            assert await scheduler.run(work, "other") == "long"

    anyio.run(scenario)


def test_a_small_long_request_does_not_wait_for_a_round_of_all_others_at_each_pause(waiting: Gauge) -> None:
    own, before = 5, Counter[str]()

    async def scenario() -> None:
        scheduler, busy = Scheduler(2, waiting, ticking()), Busy()

        def work(job: Job) -> None:
            job.spend(LONG)
            before.update(busy.stints)
            for _ in range(own):
                job.check_cancelled()
            before.subtract(busy.stints)

        async with busy_with(scheduler, busy, LONG_AT_ONCE, LONG_AT_ONCE):
            await scheduler.run(work, "other")

    anyio.run(scenario)
    # A round of all would be 16 for each of its own.
    assert -sum(before.values()) < 2 * own


def test_what_proves_long_without_having_been_announced_leaves_a_place_to_the_others(waiting: Gauge) -> None:
    stints, done = threading.Semaphore(0), threading.Event()

    def work(job: Job) -> None:
        while not done.is_set():
            stints.release()
            time.sleep(0.001)
            job.check_cancelled()

    async def scenario() -> None:
        scheduler = Scheduler(2, waiting, ticking())
        async with anyio.create_task_group() as group:
            for _ in range(2):
                group.start_soon(scheduler.run, work, "greedy")
            for _ in range(6 * YOUNG_STINTS):
                assert await to_thread.run_sync(lambda: stints.acquire(timeout=PATIENCE_S))
            assert len(scheduler._running) == 1
            done.set()

    anyio.run(scenario)


def test_clients_pay_for_the_time_that_they_compute(waiting: Gauge) -> None:
    computed, ended, gate = iter(range(1000)), [], threading.Event()

    def work(job: Job) -> None:
        if job.client == "dear":
            # The clock goes on by a second each time it is looked at.
            for _ in range(10):
                schedulers[0].clock()
        ended.append(job.client)

    schedulers: list[Scheduler] = []

    async def scenario() -> None:
        scheduler = Scheduler(1, waiting, lambda: float(next(computed)))
        schedulers.append(scheduler)
        await scheduler.run(work, "dear")
        async with anyio.create_task_group() as group:
            group.start_soon(scheduler.run, lambda job: gate.wait(PATIENCE_S), "gate")
            await until(lambda: len(scheduler._running) == 1)
            group.start_soon(scheduler.run, work, "dear")
            await until(lambda: value(waiting) == 1)
            for number in range(3):
                group.start_soon(scheduler.run, work, f"cheap {number}")
            await until(lambda: value(waiting) == 4)
            gate.set()

    anyio.run(scenario)
    assert ended[-1] == "dear"


def mixed(number: int) -> Callable[[Job], None]:
    """Short and long work, with pauses and without, some of which fails."""

    def run(job: Job) -> None:
        if number % 3 == 0:
            job.spend(LONG)
        for _ in range(number % 4):
            job.check_cancelled()
        if number % 7 == 0:
            raise ValueError

    return run


async def end_of(scheduler: Scheduler, number: int) -> str:
    """How one of many requests ends, some of them left by their clients and some cancelled."""
    left = asyncio.Event()
    if number % 5 == 0:
        asyncio.get_running_loop().call_later(0.001 * (number % 11), left.set)
    with anyio.move_on_after(0.002 if number % 6 == 5 else PATIENCE_S):
        try:
            await scheduler.run(mixed(number), f"client {number % 4}", leaving(left))
        except ValueError:
            return "failed"
        except ClientDisconnect:
            return "gone"
        return "done"
    return "cancelled"


def test_nothing_is_left_behind_by_many_that_come_go_and_fail(waiting: Gauge) -> None:
    ended: list[str] = []

    async def ask(scheduler: Scheduler, number: int) -> None:
        ended.append(await end_of(scheduler, number))

    async def scenario() -> None:
        scheduler = Scheduler(2, waiting, ticking())
        async with anyio.create_task_group() as group:
            for number in range(400):
                group.start_soon(ask, scheduler, number)
        await until(lambda: not scheduler._running and not scheduler.anybody_waits)
        assert await scheduler.run(lambda job: "next") == "next"

    anyio.run(scenario)
    assert len(ended) == 400
    assert {"done", "failed"} <= set(ended)
    assert value(waiting) == 0
