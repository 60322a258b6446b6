"""Who computes and who waits."""

import asyncio
import threading
import time
from collections.abc import Callable

import anyio
import pytest
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge
from starlette.requests import ClientDisconnect

from inference_api import turns as turns_module
from inference_api.turns import LONG_OF_CLIENT, LONG_ROWS, Turn, Turns, Watch

PATIENCE_S = 20.0
LONG = 2 * LONG_ROWS


@pytest.fixture
def waiting() -> Gauge:
    return Gauge("waiting", "Those that wait.", registry=CollectorRegistry())


def value(gauge: Gauge) -> float:
    (family,) = gauge.collect()
    return family.samples[0].value


async def until(condition: Callable[[], bool]) -> None:
    with anyio.fail_after(PATIENCE_S):
        while not condition():
            await anyio.sleep(0.005)


class Gate:
    """Work that says that it runs, and goes on when it is told."""

    def __init__(self) -> None:
        self.runs, self.open = threading.Event(), threading.Event()

    def __call__(self, turn: Turn) -> int:
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


def test_one_more_than_the_threads_waits_and_is_counted_until_its_turn(waiting: Gauge) -> None:
    open_gate, running = threading.Event(), threading.Semaphore(0)

    def work(turn: Turn) -> int:
        running.release()
        assert open_gate.wait(PATIENCE_S)
        return 7

    async def scenario() -> None:
        turns, found = Turns(2, waiting), []

        async def ask() -> None:
            found.append(await turns.run(work))

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


def test_a_request_that_is_given_up_waits_no_more(waiting: Gauge) -> None:
    gate = Gate()

    async def scenario() -> None:
        turns = Turns(1, waiting)
        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, gate)
            await gate.is_at_work()
            with anyio.move_on_after(0.05) as given_up:
                await turns.run(gate)
            assert given_up.cancelled_caught
            assert value(waiting) == 0
            gate.open.set()

    anyio.run(scenario)


def test_what_fails_is_raised_and_counted_as_done(waiting: Gauge) -> None:
    def work(turn: Turn) -> None:
        raise ValueError("no")

    async def scenario() -> None:
        turns = Turns(1, waiting)
        for _ in range(3):
            with pytest.raises(ValueError, match="no"):
                await turns.run(work)

    anyio.run(scenario)
    assert value(waiting) == 0


def test_a_client_that_leaves_the_queue_is_never_computed_for(waiting: Gauge) -> None:
    gate, computed = Gate(), []

    async def scenario() -> None:
        turns, left = Turns(1, waiting), asyncio.Event()
        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, gate)
            await gate.is_at_work()

            async def ask() -> None:
                with pytest.raises(ClientDisconnect):
                    await turns.run(lambda turn: computed.append(1), "gone", leaving(left))

            group.start_soon(ask)
            await until(lambda: value(waiting) == 1)
            left.set()
            await until(lambda: value(waiting) == 0)
            gate.open.set()
        assert await turns.run(lambda turn: "next") == "next"

    anyio.run(scenario)
    assert computed == []


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
        turns, left = Turns(1, waiting), asyncio.Event()
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
        turns, found = Turns(threads, waiting), []

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
        turns = Turns(3, waiting)
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
        turns = Turns(2, waiting)
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
        turns = Turns(3, waiting)
        async with anyio.create_task_group() as group:
            for number in range(12):
                group.start_soon(turns.run, work, f"client {number % 2}")

    anyio.run(scenario)
    assert max(most) == LONG_OF_CLIENT


def test_a_client_that_leaves_when_it_is_called_and_before_its_thread_begins_leaves_its_place(
    waiting: Gauge,
) -> None:
    gate, computed = Gate(), []

    async def scenario() -> None:
        turns = Turns(1, waiting)
        clients: list[Callable[[], None]] = []

        def watch(leave: Callable[[], None]) -> Callable[[], None]:
            clients.append(leave)
            return lambda: None

        async def ask() -> None:
            with pytest.raises(ClientDisconnect):
                await turns.run(lambda turn: computed.append(1), "gone", watch)

        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, gate)
            await gate.is_at_work()
            group.start_soon(ask)
            await until(lambda: value(waiting) == 1)
            first = next(iter(turns._running))
            # In one step of the loop: the place is free, the next one is called, and goes.
            turns.leave(first)
            clients[0]()
            gate.open.set()
        with anyio.fail_after(PATIENCE_S):
            assert await turns.run(lambda turn: "next") == "next"
        assert not turns._running

    anyio.run(scenario)
    assert computed == []


def test_one_that_is_cancelled_keeps_its_place_until_its_thread_ends(waiting: Gauge) -> None:
    gate = Gate()

    async def scenario() -> None:
        turns = Turns(1, waiting)
        with anyio.move_on_after(0.05) as cancelled:
            await turns.run(gate)
        assert cancelled.cancelled_caught
        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, lambda turn: None)
            await until(lambda: value(waiting) == 1)
            gate.open.set()
        assert value(waiting) == 0

    anyio.run(scenario)


def test_a_stint_without_an_end_is_noticed(waiting: Gauge, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate()

    async def scenario() -> None:
        turns = Turns(1, waiting)
        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, gate)
            await gate.is_at_work()
            assert not turns.are_stuck
            monkeypatch.setattr(turns_module, "STUCK_S", 0.0)
            await until(lambda: turns.are_stuck)
            gate.open.set()
        assert not turns.are_stuck

    anyio.run(scenario)


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
        turns = Turns(2, waiting)
        async with anyio.create_task_group() as group:
            for number in range(400):
                group.start_soon(ask, turns, number)
        await until(lambda: not turns._running and not turns.anybody_waits)
        assert await turns.run(lambda turn: "next") == "next"

    anyio.run(scenario)
    assert len(ended) == 400
    assert {"done", "failed"} <= set(ended)
    assert value(waiting) == 0
