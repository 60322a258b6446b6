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

from inference_api.turns.turns import LONG_AT_ONCE, LONG_OF_CLIENT, Turn, Turns
from tests.inference_api.turn_work import LONG, PATIENCE_S, YOUNG_STINTS, leaving, ticking, until, value


@pytest.fixture
def waiting() -> Gauge:
    return Gauge("waiting", "Those that wait.", registry=CollectorRegistry())


def test_a_long_request_whose_client_leaves_ends_at_its_next_pause(waiting: Gauge) -> None:
    stints, last = [], threading.Event()

    def work(turn: Turn) -> None:
        turn.spend(LONG)
        for number in range(10_000):
            stints.append(number)
            last.set()
            time.sleep(0.001)
            turn.between()

    async def scenario() -> None:
        turns, left = Turns(1, waiting, ticking()), asyncio.Event()
        async with anyio.create_task_group() as group:

            async def ask() -> None:
                with pytest.raises(ClientDisconnect):
                    await turns.run(work, "gone", leaving(left))

            group.start_soon(ask)
            assert await to_thread.run_sync(last.wait, PATIENCE_S)
            left.set()
        assert await turns.run(lambda turn: "next") == "next"

    anyio.run(scenario)
    assert len(stints) < 5000


@pytest.mark.parametrize("threads", [1, 2])
def test_a_short_request_does_not_wait_for_the_end_of_long_ones(waiting: Gauge, threads: int) -> None:
    begun, done = threading.Semaphore(0), threading.Event()

    def work(turn: Turn) -> str:
        turn.spend(LONG)
        begun.release()
        while not done.is_set():
            time.sleep(0.001)
            turn.between()
        return "long"

    async def scenario() -> None:
        turns, found = Turns(threads, waiting, ticking()), []

        async def ask() -> None:
            found.append(await turns.run(work, "greedy"))

        async with anyio.create_task_group() as group:
            for _ in range(3):
                group.start_soon(ask)
            assert await to_thread.run_sync(lambda: begun.acquire(timeout=PATIENCE_S))
            with anyio.fail_after(PATIENCE_S):
                for _ in range(5):
                    assert await turns.run(lambda turn: "short", "other") == "short"
            done.set()
        assert found == ["long"] * 3

    anyio.run(scenario)


def test_long_requests_leave_a_thread_to_the_others(waiting: Gauge) -> None:
    at_work, most, done = [], [], threading.Event()

    def work(turn: Turn) -> None:
        turn.spend(LONG)
        at_work.append(turn)
        most.append(len(at_work))
        assert done.wait(0.05) or True
        at_work.remove(turn)

    async def scenario() -> None:
        turns = Turns(3, waiting, ticking())
        async with anyio.create_task_group() as group:
            for number in range(6):
                group.start_soon(turns.run, work, f"client {number}")

    anyio.run(scenario)
    assert max(most) == 2


def test_a_free_place_that_long_requests_may_not_take_is_taken_at_once(waiting: Gauge) -> None:
    begun, done = threading.Semaphore(0), threading.Event()

    def work(turn: Turn) -> None:
        turn.spend(LONG)
        begun.release()
        assert done.wait(PATIENCE_S)

    async def scenario() -> None:
        turns = Turns(2, waiting, ticking())
        async with anyio.create_task_group() as group:
            for _ in range(2):
                group.start_soon(turns.run, work, "greedy")
            assert await to_thread.run_sync(lambda: begun.acquire(timeout=PATIENCE_S))
            await until(lambda: value(waiting) == 1)
            with anyio.fail_after(PATIENCE_S):
                # The long one that runs comes to no pause, and the other one may not run beside it.
                assert await turns.run(lambda turn: "short", "other") == "short"
            done.set()

    anyio.run(scenario)


def test_few_long_requests_of_a_client_are_under_way_at_once(waiting: Gauge) -> None:
    under_way, most = set(), []

    def work(turn: Turn) -> None:
        turn.spend(LONG)
        under_way.add(turn)
        most.append(sum(other.client == turn.client for other in under_way))
        for _ in range(5):
            time.sleep(0.001)
            turn.between()
        under_way.discard(turn)

    async def scenario() -> None:
        turns = Turns(3, waiting, ticking())
        async with anyio.create_task_group() as group:
            for number in range(12):
                group.start_soon(turns.run, work, f"client {number % 2}")

    anyio.run(scenario)
    assert max(most) == LONG_OF_CLIENT


class Busy:
    """Long work without an end, of which stints are counted by client."""

    def __init__(self) -> None:
        self.stints: Counter[str] = Counter()
        self.done = threading.Event()

    def __call__(self, turn: Turn) -> None:
        turn.spend(LONG)
        while not self.done.is_set():
            self.stints[turn.client] += 1
            time.sleep(0.0005)
            turn.between()


@asynccontextmanager
async def busy_with(turns: Turns, busy: Busy, requests: int, clients: int) -> AsyncIterator[None]:
    """So many requests of so many clients, all of which have begun and are not young any more."""
    async with anyio.create_task_group() as group:
        for number in range(requests):
            group.start_soon(turns.run, busy, f"busy {number % clients}")
        most = min(requests, LONG_AT_ONCE)
        await until(lambda: sum(busy.stints.values()) > most * YOUNG_STINTS)
        with anyio.fail_after(PATIENCE_S):
            yield
        busy.done.set()


def test_a_client_whose_many_addresses_fill_all_places_of_long_requests_locks_nobody_out(
    waiting: Gauge,
) -> None:
    async def scenario() -> None:
        turns, busy = Turns(2, waiting, ticking()), Busy()
        async with busy_with(turns, busy, 2 * LONG_AT_ONCE, LONG_AT_ONCE):

            def work(turn: Turn) -> str:
                turn.spend(LONG)
                turn.between()
                return "long"

            assert await turns.run(work, "other") == "long"

    anyio.run(scenario)


def test_a_small_long_request_does_not_wait_for_a_round_of_all_others_at_each_pause(waiting: Gauge) -> None:
    own, before = 5, Counter[str]()

    async def scenario() -> None:
        turns, busy = Turns(2, waiting, ticking()), Busy()

        def work(turn: Turn) -> None:
            turn.spend(LONG)
            before.update(busy.stints)
            for _ in range(own):
                turn.between()
            before.subtract(busy.stints)

        async with busy_with(turns, busy, LONG_AT_ONCE, LONG_AT_ONCE):
            await turns.run(work, "other")

    anyio.run(scenario)
    # A round of all would be 16 for each of its own.
    assert -sum(before.values()) < 2 * own


def test_what_proves_long_without_having_been_announced_leaves_a_place_to_the_others(waiting: Gauge) -> None:
    stints, done = threading.Semaphore(0), threading.Event()

    def work(turn: Turn) -> None:
        while not done.is_set():
            stints.release()
            time.sleep(0.001)
            turn.between()

    async def scenario() -> None:
        turns = Turns(2, waiting, ticking())
        async with anyio.create_task_group() as group:
            for _ in range(2):
                group.start_soon(turns.run, work, "greedy")
            for _ in range(6 * YOUNG_STINTS):
                assert await to_thread.run_sync(lambda: stints.acquire(timeout=PATIENCE_S))
            assert len(turns._running) == 1
            done.set()

    anyio.run(scenario)


def test_a_request_that_waits_for_nobody_ends_at_a_pause_when_its_client_leaves(waiting: Gauge) -> None:
    begun, stints = threading.Event(), []

    def work(turn: Turn) -> None:
        for number in range(10_000):
            begun.set()
            stints.append(number)
            time.sleep(0.001)
            turn.between()

    async def scenario() -> None:
        turns, left = Turns(2, waiting, ticking()), asyncio.Event()
        async with anyio.create_task_group() as group:

            async def ask() -> None:
                with pytest.raises(ClientDisconnect):
                    await turns.run(work, "gone", leaving(left))

            group.start_soon(ask)
            assert await to_thread.run_sync(begun.wait, PATIENCE_S)
            left.set()

    anyio.run(scenario)
    assert len(stints) < 5000


def test_clients_pay_for_the_time_that_they_compute(waiting: Gauge) -> None:
    computed, ended, gate = iter(range(1000)), [], threading.Event()

    def work(turn: Turn) -> None:
        if turn.client == "dear":
            # The clock goes on by a second each time it is looked at.
            for _ in range(10):
                turns_of[0].clock()
        ended.append(turn.client)

    turns_of: list[Turns] = []

    async def scenario() -> None:
        turns = Turns(1, waiting, lambda: float(next(computed)))
        turns_of.append(turns)
        await turns.run(work, "dear")
        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, lambda turn: gate.wait(PATIENCE_S), "gate")
            await until(lambda: len(turns._running) == 1)
            group.start_soon(turns.run, work, "dear")
            await until(lambda: value(waiting) == 1)
            for number in range(3):
                group.start_soon(turns.run, work, f"cheap {number}")
            await until(lambda: value(waiting) == 4)
            gate.set()

    anyio.run(scenario)
    assert ended[-1] == "dear"


def mixed(number: int) -> Callable[[Turn], None]:
    """Short and long work, with pauses and without, some of which fails."""

    def run(turn: Turn) -> None:
        if number % 3 == 0:
            turn.spend(LONG)
        for _ in range(number % 4):
            turn.between()
        if number % 7 == 0:
            raise ValueError

    return run


async def end_of(turns: Turns, number: int) -> str:
    """How one of many requests ends, some of them left by their clients and some cancelled."""
    left = asyncio.Event()
    if number % 5 == 0:
        asyncio.get_running_loop().call_later(0.001 * (number % 11), left.set)
    with anyio.move_on_after(0.002 if number % 6 == 5 else PATIENCE_S):
        try:
            await turns.run(mixed(number), f"client {number % 4}", leaving(left))
        except ValueError:
            return "failed"
        except ClientDisconnect:
            return "gone"
        return "done"
    return "cancelled"


def test_nothing_is_left_behind_by_many_that_come_go_and_fail(waiting: Gauge) -> None:
    ended: list[str] = []

    async def ask(turns: Turns, number: int) -> None:
        ended.append(await end_of(turns, number))

    async def scenario() -> None:
        turns = Turns(2, waiting, ticking())
        async with anyio.create_task_group() as group:
            for number in range(400):
                group.start_soon(ask, turns, number)
        await until(lambda: not turns._running and not turns.anybody_waits)
        assert await turns.run(lambda turn: "next") == "next"

    anyio.run(scenario)
    assert len(ended) == 400
    assert {"done", "failed"} <= set(ended)
    assert value(waiting) == 0
