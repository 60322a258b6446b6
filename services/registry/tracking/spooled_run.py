"""A run whose metrics wait on disk while the server is away, so that training goes on and nothing is lost."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from cspace.errors import RegistryUnavailableError
from services.registry.tracking.metric_buffer import MetricBuffer, MetricPoint, Patience, points_of
from services.registry.tracking.mlflow_run import MlflowRun
from services.registry.tracking.port import Picture, RunStatus
from services.registry.tracking.run_block import RunBlock
from services.registry.tracking.spool import Ending, Spool

_LOG = logging.getLogger("training")
# A server that hangs costs the client's patience at each try.
RETRY_S = 10.0


class SpooledRun(RunBlock):
    """The port :class:`services.registry.tracking.port.RunLog` on MLflow with a spool.

    Metrics and the run's end never raise RegistryUnavailableError; everything else does, as its caller waits.
    What waits in the spool, of this process or of an earlier one, is delivered first, and steps that the
    server holds already are dropped.

    Args:
        run_id: of the run.
        reopen: asks the server for the run as it is, and goes on with it.
        spool: of the run.
        patience: when metrics are sent; its clock tells as well when the server is tried again.
    """

    def __init__(
        self, run_id: str, reopen: Callable[[], MlflowRun], spool: Spool, patience: Patience
    ) -> None:
        self._run_id, self._reopen, self._spool, self._clock = run_id, reopen, spool, patience.clock
        self._run: MlflowRun | None = None
        self._away_until_s = float("-inf")
        self._buffer = MetricBuffer(self._send, patience)

    @property
    def run_id(self) -> str:
        """The run's id."""
        return self._run_id

    def open(self) -> Self:
        """Look whether the run is there, if the server is.

        Raises:
            RegistryError: there is no such run.
        """
        with suppress(RegistryUnavailableError):
            self._opened()
        return self

    def metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Log metrics: buffered, then sent, or kept on disk."""
        self._buffer.add(points_of(metrics, step))

    def flush(self) -> None:
        """Send the metrics that wait, or keep them on disk."""
        self._buffer.flush()

    def deliver(self) -> None:
        """Send what waits on disk, and end the run if it had ended.

        Raises:
            RegistryUnavailableError: the server is away.
        """
        waiting = self._spool.read()
        self._opened(fresh=True).points(_first_of_each(waiting.points))
        if waiting.ending is not None:
            self._opened().end(waiting.ending.status, waiting.ending.time_ms)
        self._spool.clear()

    def finish(self, status: RunStatus = "FINISHED") -> None:
        """Send what waits and end the run, or keep its end on disk."""
        self.flush()
        ending = Ending(status, time.time_ns() // 1_000_000)
        try:
            if self._spool:
                self.deliver()
            self._opened().end(ending.status, ending.time_ms)
        except RegistryUnavailableError:
            self._spool.end(ending)

    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters, flattened."""
        self._opened().params(params)

    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags."""
        self._opened().tags(tags)

    def artifact(self, path: Path, folder: str = "") -> None:
        """Upload a file, or a folder's content."""
        self._opened().artifact(path, folder)

    def figure(self, fig: Picture, name: str) -> None:
        """Render a figure as PNG and upload it."""
        self._opened().figure(fig, name)

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Upload a table."""
        self._opened().table(columns, name)

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input."""
        self._opened().dataset(name, digest, source, context)

    def _opened(self, *, fresh: bool = False) -> MlflowRun:
        if self._run is None or fresh:
            self._run = self._reopen()
        return self._run

    def _send(self, points: Sequence[MetricPoint]) -> None:
        if self._clock() < self._away_until_s:
            self._spool.add(points)
            return
        try:
            if self._spool:
                self.deliver()
                # What was delivered counts as held from here on.
                self._opened(fresh=True)
            self._opened().points(points)
        except RegistryUnavailableError as error:
            if not self._spool:
                _LOG.warning("run %s: metrics wait on disk: %s", self._run_id, error)
            self._away_until_s = self._clock() + RETRY_S
            self._spool.add(points)


def _first_of_each(points: Sequence[MetricPoint]) -> list[MetricPoint]:
    """Without the repetitions of attempts that all had to wait: a step's first value stays."""
    last: dict[str, int] = {}
    found = []
    for point in points:
        if point.step > last.get(point.name, -1):
            last[point.name] = point.step
            found.append(point)
    return found
