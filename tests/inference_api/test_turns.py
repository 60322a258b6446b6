"""Who computes and who waits."""

import threading

import anyio
import pytest
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge

from inference_api.turns import Turns

PATIENCE_S = 20.0


@pytest.fixture
def waiting() -> Gauge:
    return Gauge("waiting", "Those that wait.", registry=CollectorRegistry())


def value(gauge: Gauge) -> float:
    (family,) = gauge.collect()
    return family.samples[0].value


def test_one_more_than_the_threads_waits_and_is_counted_until_its_turn(waiting: Gauge) -> None:
    open_gate, running = threading.Event(), threading.Semaphore(0)

    def work() -> int:
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
    open_gate, running = threading.Event(), threading.Event()

    def work() -> None:
        running.set()
        assert open_gate.wait(PATIENCE_S)

    async def scenario() -> None:
        turns = Turns(1, waiting)
        async with anyio.create_task_group() as group:
            group.start_soon(turns.run, work)
            assert await to_thread.run_sync(running.wait, PATIENCE_S)
            with anyio.move_on_after(0.05) as given_up:
                await turns.run(work)
            assert given_up.cancelled_caught
            assert value(waiting) == 0
            open_gate.set()

    anyio.run(scenario)


def test_what_fails_is_raised_and_counted_as_done(waiting: Gauge) -> None:
    def work() -> None:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        anyio.run(Turns(1, waiting).run, work)
    assert value(waiting) == 0
