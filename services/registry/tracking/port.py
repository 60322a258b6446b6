"""The port to experiment tracking: runs that hold parameters, metrics, pictures and the data that went in."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol

RunStatus = Literal["FINISHED", "FAILED", "KILLED"]
NOTHING: Mapping[str, Any] = MappingProxyType({})
ID, ID_LENGTH = "{id}", 6
"""In a run's name, and how much of the run's id stands there instead."""


class Picture(Protocol):
    """What can draw itself as a PNG file, as matplotlib's figures do."""

    def savefig(self, fname: Any, *, format: str) -> None:  # noqa: A002 - matplotlib's own name
        """Write the picture to a file."""
        ...


class RunLog(AbstractContextManager["RunLog", None], Protocol):
    """One run that is being written. Not for sharing between threads.

    As a context manager it finishes the run, FAILED when an exception ends the block (KILLED when the
    exception is an interrupt). Every method raises RegistryUnavailableError when the server does not answer;
    metrics that could not be sent are kept and sent with the next ones.
    """

    @property
    def run_id(self) -> str:
        """Survives in a checkpoint; :meth:`Tracking.resume` goes on with it."""
        ...

    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters; nested mappings become dotted names. A parameter keeps its first value for good."""
        ...

    def metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Log metrics of one step. They are buffered, and sent by number, by age, and at the end."""
        ...

    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags; the last value holds."""
        ...

    def artifact(self, path: Path, folder: str = "") -> None:
        """Keep a copy of a file, or of a folder's content.

        Args:
            path: the file or folder.
            folder: under which name in the run.

        Raises:
            RegistryError: there is nothing at the path.
        """
        ...

    def figure(self, fig: Picture, name: str) -> None:
        """Keep a figure as ``figures/<name>.png``, and where the UI sets runs' pictures beside each other.

        The figure stays open.
        """
        ...

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Keep a table as ``tables/<name>.json``, which the UI compares between runs, and as Parquet.

        Args:
            columns: by name, all of one length: numbers, texts or None.
            name: of the table.
        """
        ...

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input of the run.

        Args:
            name: of the data set.
            digest: SHA-256 in hexadecimal.
            source: where it lies: a folder or an address.
            context: what it is used for: ``training``, ``evaluation``.
        """
        ...

    def flush(self) -> None:
        """Send the metrics that wait."""
        ...

    def finish(self, status: RunStatus = "FINISHED") -> None:
        """Send what waits and end the run."""
        ...


class Tracking(Protocol):
    """Where runs are kept. Runs are named by their ids; no run is ever current."""

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
        key: str | None = None,
    ) -> RunLog:
        """Start a run, or go on with the one of the same key.

        Args:
            experiment: created when it is new.
            name: of the run; :data:`ID` in it becomes the first :data:`ID_LENGTH` characters of the run's id.
            parent_run_id: the run under which it is shown.
            tags: commit, seeds, preset.
            key: names the run within its experiment for whoever was interrupted before he could remember its
                id: letters, digits, ``-``, ``_`` and ``/``. None always starts a new one.
        """
        ...

    def resume(self, run_id: str, from_step: int | None = None) -> RunLog:
        """Go on with a run that was started before, by this or by another process.

        A job that goes on from a checkpoint repeats the steps after it, and a tracking server can not take
        back what it has. So metrics of a step that the run holds already are dropped.

        Args:
            run_id: from :attr:`RunLog.run_id`.
            from_step: metrics of earlier steps are dropped. None asks the run, metric by metric, for its
                last step.

        Raises:
            RegistryError: there is no such run.
        """
        ...

    def note(
        self, run_id: str, *, tags: Mapping[str, str] = NOTHING, metrics: Mapping[str, float] = NOTHING
    ) -> None:
        """Write onto a run without going on with it, whether it has ended or not.

        Args:
            run_id: from :attr:`RunLog.run_id`.
            tags: set.
            metrics: logged at step 0; the last ones logged hold.

        Raises:
            RegistryError: there is no such run.
        """
        ...

    def deliver(self) -> None:
        """Send what had to wait for the server, of all runs. Without a place to wait in there is nothing.

        Raises:
            RegistryUnavailableError: the server is away.
        """
        ...
