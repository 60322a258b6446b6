"""Runs as they are found again: what each was told, and the files that it keeps."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mlflow import MlflowClient
from mlflow.artifacts import download_artifacts
from mlflow.entities import Run

from cspace.errors import RegistryError
from services.registry.mlflow_errors import mapped

_PARENT = "mlflow.parentRunId"


@dataclass(frozen=True, slots=True)
class FoundRun:
    """A run.

    Args:
        run_id: its id.
        name: its name.
        parent_run_id: the run under which it is shown; None for one of its own.
        tags: all of them.
        metrics: the last value of each.
        started_ms: milliseconds since 1970-01-01 UTC.
    """

    run_id: str
    name: str
    parent_run_id: str | None
    tags: Mapping[str, str]
    metrics: Mapping[str, float]
    started_ms: int


class Runs(Protocol):
    """Where runs are found again.

    Every method raises RegistryUnavailableError when the server does not answer.
    """

    def run(self, run_id: str) -> FoundRun:
        """One run.

        Raises:
            RegistryError: there is none.
        """
        ...

    def children(self, run_id: str) -> tuple[FoundRun, ...]:
        """The runs that are shown under another, newest first."""
        ...

    def file(self, run_id: str, path: str, folder: Path) -> Path | None:
        """A file that a run keeps, fetched into a folder; None where it keeps none of this name."""
        ...


class MlflowRuns:
    """The port :class:`Runs` on MLflow.

    Args:
        uri: of the tracking server.
    """

    def __init__(self, uri: str) -> None:
        with mapped("opening the tracking server"):
            self._client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self._uri = uri

    def run(self, run_id: str) -> FoundRun:
        """One run; see :meth:`Runs.run`."""
        with mapped(f"looking up the run {run_id}"):
            return _found(self._client.get_run(run_id))

    def children(self, run_id: str) -> tuple[FoundRun, ...]:
        """The runs under another; see :meth:`Runs.children`."""
        with mapped(f"looking up the runs under {run_id}"):
            experiment_id = self._client.get_run(run_id).info.experiment_id
            found: list[Run] = []
            token: str | None = ""
            while token is not None:
                page = self._client.search_runs(
                    [experiment_id],
                    f"tags.`{_PARENT}` = '{run_id}'",
                    order_by=["attributes.start_time DESC"],
                    page_token=token or None,
                )
                found += page
                token = page.token or None
        return tuple(map(_found, found))

    def file(self, run_id: str, path: str, folder: Path) -> Path | None:
        """A file of a run; see :meth:`Runs.file`."""
        parent = Path(path).parent.as_posix()
        with mapped(f"fetching {path} of run {run_id}"):
            there = self._client.list_artifacts(run_id, None if parent == "." else parent)
            if all(one.path != path for one in there):
                return None
            fetched = download_artifacts(
                run_id=run_id, artifact_path=path, dst_path=str(folder), tracking_uri=self._uri
            )
        return Path(fetched)


def _found(run: Run) -> FoundRun:
    if run.info.lifecycle_stage != "active":
        raise RegistryError(f"the run {run.info.run_id} was deleted", remedy="restore it in the MLflow UI")
    tags = dict(run.data.tags)
    return FoundRun(
        str(run.info.run_id),
        str(run.info.run_name),
        tags.get(_PARENT),
        tags,
        dict(run.data.metrics),
        int(run.info.start_time),
    )
