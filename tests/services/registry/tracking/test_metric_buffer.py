from collections.abc import Sequence

import pytest

from services.registry.tracking.metric_buffer import MAX_BATCH, MetricBuffer, MetricPoint, Patience


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class Sink:
    def __init__(self) -> None:
        self.batches: list[list[int]] = []
        self.away = False

    def __call__(self, points: Sequence[MetricPoint]) -> None:
        if self.away:
            raise ConnectionError
        self.batches.append([point.step for point in points])


def points(*steps: int) -> list[MetricPoint]:
    return [MetricPoint("kl", 0.5, step, 0) for step in steps]


@pytest.fixture
def sink() -> Sink:
    return Sink()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def buffer(sink: Sink, clock: Clock) -> MetricBuffer:
    return MetricBuffer(sink, Patience(3, 10.0, clock))


def test_points_wait_until_there_are_enough(buffer: MetricBuffer, sink: Sink) -> None:
    buffer.add(points(0))
    buffer.add(points(1))
    assert sink.batches == []
    buffer.add(points(2))
    assert sink.batches == [[0, 1, 2]]


def test_points_wait_until_the_first_is_old(buffer: MetricBuffer, sink: Sink, clock: Clock) -> None:
    buffer.add(points(0))
    clock.now_s = 9.9
    buffer.add(points(1))
    assert sink.batches == []
    clock.now_s = 10.0
    buffer.add([])
    assert sink.batches == [[0, 1]]


def test_age_counts_from_the_first_point_that_waits(buffer: MetricBuffer, sink: Sink, clock: Clock) -> None:
    buffer.add(points(0))
    buffer.flush()
    clock.now_s = 100.0
    buffer.add(points(1))
    assert sink.batches == [[0]]


def test_nothing_is_sent_when_nothing_waits(buffer: MetricBuffer, sink: Sink) -> None:
    buffer.flush()
    buffer.add([])
    assert sink.batches == []


def test_no_batch_is_larger_than_the_server_takes(sink: Sink) -> None:
    buffer = MetricBuffer(sink, Patience(10_000))
    buffer.add(points(*range(2 * MAX_BATCH + 5)))
    buffer.flush()
    assert [len(batch) for batch in sink.batches] == [MAX_BATCH, MAX_BATCH, 5]


def test_points_that_could_not_be_sent_are_sent_with_the_next(buffer: MetricBuffer, sink: Sink) -> None:
    sink.away = True
    buffer.add(points(0, 1))
    with pytest.raises(ConnectionError):
        buffer.flush()
    sink.away = False
    buffer.add(points(2))
    assert sink.batches == [[0, 1, 2]]
