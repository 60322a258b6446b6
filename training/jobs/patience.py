"""What a job's driver does while the tracking server is away: it waits, says so, and goes on."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from cspace.errors import RegistryUnavailableError
from services.registry.tracking.port import Picture, RunLog, RunStatus

_LOG = logging.getLogger("training")
LOOK_EVERY_S = 5.0
# Between two lines of a log that say the same.
LINE_EVERY_S = 60.0

Answer = TypeVar("Answer")


def patiently(
    action: str,
    call: Callable[[], Answer],
    patience_s: float,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> Answer:
    """The answer of ``call``, asked again while the tracking server is away.

    Args:
        action: what is being done, for the log.
        call: may be called again after it has failed.
        patience_s: how long the server may be away.
        sleep: waits for so many seconds.
        clock: seconds, monotonic.

    Raises:
        RegistryUnavailableError: it stayed away; what is done so far is kept, and the job can be resumed.
    """
    began, said = clock(), float("-inf")
    while True:
        try:
            return call()
        except RegistryUnavailableError as error:
            waited = clock() - began
            if waited >= patience_s:
                raise RegistryUnavailableError(
                    f"{action}: the tracking server stayed away for {waited:.0f} s",
                    expected=error.expected,
                    got=error.got,
                    remedy="nothing is lost: start it, then submit the job again by name or resume its run",
                ) from error
            if clock() - said >= LINE_EVERY_S:
                said = clock()
                _LOG.info(
                    "%s: the tracking server is away, waiting up to %.0f s", action, patience_s - waited
                )
            sleep(LOOK_EVERY_S)


class PatientRun:
    """A :class:`services.registry.tracking.port.RunLog` whose calls wait for the server; metrics do not.

    Args:
        run: what it hands the calls on to; its calls may be repeated.
        patience_s: how long the server may be away.
    """

    def __init__(self, run: RunLog, patience_s: float) -> None:
        self._run, self._patience_s = run, patience_s

    @property
    def run_id(self) -> str:
        """The run's id."""
        return self._run.run_id

    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters."""
        self._wait("logging parameters", lambda: self._run.params(params))

    def metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Log metrics."""
        self._run.metrics(metrics, step)

    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags."""
        self._wait("setting tags", lambda: self._run.tags(tags))

    def artifact(self, path: Path, folder: str = "") -> None:
        """Upload a file, or a folder's content."""
        self._wait(f"uploading {path.name}", lambda: self._run.artifact(path, folder))

    def figure(self, fig: Picture, name: str) -> None:
        """Render a figure and upload it."""
        self._wait(f"uploading {name}", lambda: self._run.figure(fig, name))

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Upload a table."""
        self._wait(f"uploading {name}", lambda: self._run.table(columns, name))

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input."""
        self._wait("logging the data set", lambda: self._run.dataset(name, digest, source, context))

    def flush(self) -> None:
        """Send the metrics that wait."""
        self._run.flush()

    def finish(self, status: RunStatus = "FINISHED") -> None:
        """End the run."""
        self._run.finish(status)

    def __enter__(self) -> Self:
        self._run.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._run.__exit__(kind, error, trace)

    def _wait(self, action: str, call: Callable[[], None]) -> None:
        patiently(action, call, self._patience_s)
