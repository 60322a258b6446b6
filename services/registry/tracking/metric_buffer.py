"""Metrics on their way to the server: kept until there are many of them or the first has waited long.

One call costs about as much for one metric as for many, so that a call a step would slow training down.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

# MLflow's own limit of one batch.
MAX_BATCH = 1000


@dataclass(frozen=True, slots=True)
class MetricPoint:
    """One value of one metric.

    Args:
        name: of the metric.
        value: may be infinite or not a number.
        step: of training.
        time_ms: when it was logged, milliseconds since 1970-01-01 UTC.
    """

    name: str
    value: float
    step: int
    time_ms: int


def points_of(metrics: Mapping[str, float], step: int) -> list[MetricPoint]:
    """The metrics of one step, logged now."""
    now_ms = time.time_ns() // 1_000_000
    return [MetricPoint(name, float(value), step, now_ms) for name, value in metrics.items()]


@dataclass(frozen=True, slots=True)
class Patience:
    """When points are sent.

    Args:
        size: number of points that are worth a call.
        age_s: how long a point may wait for others. Looked at when the next one comes: there is no thread.
        clock: seconds, monotonic.
    """

    size: int = 500
    age_s: float = 5.0
    clock: Callable[[], float] = time.monotonic


class MetricBuffer:
    """Collects points and hands them on in batches.

    Args:
        write: sends a batch of at most 1000 points; when it raises, the points are kept.
        patience: when it does.
    """

    def __init__(self, write: Callable[[Sequence[MetricPoint]], None], patience: Patience) -> None:
        self._write, self._patience = write, patience
        self._points: list[MetricPoint] = []
        self._since_s = 0.0

    def add(self, points: Sequence[MetricPoint]) -> None:
        """Take points, and send everything that waits when it is time."""
        now = self._patience.clock()
        if not self._points:
            self._since_s = now
        self._points.extend(points)
        if len(self._points) >= self._patience.size or now - self._since_s >= self._patience.age_s:
            self.flush()

    def flush(self) -> None:
        """Send everything that waits."""
        while self._points:
            batch = self._points[:MAX_BATCH]
            self._write(batch)
            del self._points[: len(batch)]
