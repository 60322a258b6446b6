"""Runs on an MLflow server, named by their ids; no run is ever current.

MLflow's own asynchronous logging loses what a killed process had queued. So metrics are sent in batches, and
a trial sends them from its checkpoint: those that the server missed are sent again, and it drops the points
that it has.
"""

import json
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import PIL.Image
from mlflow import MlflowClient
from mlflow.artifacts import download_artifacts
from mlflow.entities import Dataset, DatasetInput, Experiment, InputTag, Metric, Param, Run, RunTag
from mlflow.exceptions import MlflowException
from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository
from mlflow.store.entities import PagedList
from mlflow.utils import get_results_from_paginated_fn

from cspace.errors import RegistryError
from services.names import (
    MLFLOW_TRAINING,
    NOTE,
    OUTCOMES_EXPERIMENT,
    TAG_JOB,
    TAG_KEY,
    TAG_MODEL,
    TAG_PARENT,
    TAG_PRESET,
    TAG_STAGE,
)
from services.registry.entities import ID, ID_LENGTH, RunStatus, flatten
from services.registry.errors import mapped, retry

# Limits of the server: metrics and parameters in one call, and characters of a data set's digest.
MAX_BATCH, _MAX_PARAMS, MAX_DIGEST = 1000, 100, 36
_PAGE = 1000
Answer = TypeVar("Answer")
Item = TypeVar("Item")


# What the UI keeps of a search when somebody presses Share: a tag of the experiment, opened by
# ``viewStateShareKey`` in the address.
VIEW = "mlflow.sharedViewState."
_QUALITY = ("precision", "served_precision", "coverage", "served_coverage", "edr", "planning_success")
# What each shows, which runs, and the columns.
VIEWS: dict[str, tuple[str, str, list[str]]] = {
    "jobs": (
        "every training job with its settings and the figures of its last evaluation",
        f"tags.{TAG_STAGE} LIKE '%-train'",
        [f"tags.`{TAG_MODEL}`", *(f"params.`{name}`" for name in ("seed", "clusters.form", "local.steps"))]
        + [f"metrics.`validation/{name}`" for name in _QUALITY],
    ),
    "trials": (
        "the local trials of all jobs, with the parameters and last losses of each",
        f"tags.{TAG_STAGE} = 'local'",
        [f"tags.`{TAG_JOB}`", f"tags.`{TAG_PRESET}`"]
        + [f"params.`{name}`" for name in ("cluster", "share_of_data", "steps", "seed", "parameters")]
        + ["metrics.`critic_loss`", "metrics.`wasserstein_estimate`"]
        + ["metrics.`generator_loss`", "metrics.`steps_per_s`"],
    ),
    "evaluations": (
        "every evaluation of a registered version, validation and test",
        f"tags.{TAG_STAGE} = 'evaluation'",
        [f"tags.`{TAG_MODEL}`", "tags.`promoted`", "params.`seed`", "params.`scenarios`"]
        + [f"metrics.`{split}/{name}`" for split in ("validation", "test") for name in _QUALITY[:5]],
    ),
    "planning": (
        "the planning benchmarks",
        f"tags.{TAG_STAGE} = 'planning-benchmark'",
        ["tags.`protocol`", "params.`setting.seed`"],
    ),
}


class Tracking:
    """Where runs are kept. Calls wait ``wait_s`` for a server that is away; None raises at once."""

    def __init__(self, uri: str, *, wait_s: float | None = None) -> None:
        with mapped("opening the tracking server"):
            self.client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self._uri, self._wait_s = uri, wait_s

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
        key: str | None = None,
    ) -> "RunLog":
        """Start a run, or go on with that of the same key; ``{id}`` in a name becomes the start of its id."""
        more = {TAG_PARENT: parent_run_id, TAG_KEY: key}
        all_tags = {**(tags or {}), **{name: value for name, value in more.items() if value is not None}}

        def start() -> RunLog:
            experiment_id = self._experiment_id(experiment)
            query = f"tags.`{TAG_KEY}` = '{key}'"
            found = [] if key is None else self.client.search_runs([experiment_id], query, max_results=1)
            run = found[0] if found else self.client.create_run(experiment_id, run_name=name, tags=all_tags)
            run_id, title = str(run.info.run_id), str(run.info.run_name)
            if ID in title:
                self.client.update_run(run_id, name=title.replace(ID, run_id[:ID_LENGTH]))
            log = RunLog(self, run_id)
            log.open()
            return log

        return self.ask(f"starting the run {name}", start)

    def resume(self, run_id: str) -> "RunLog":
        """Go on with a run that was started before, by this or by another process."""
        log = RunLog(self, run_id)
        self.ask(f"resuming the run {run_id}", log.open)
        return log

    def note(self, run_id: str, tags: Mapping[str, str]) -> None:
        """Set tags of a run, whether it has ended or not; it is not resumed."""
        pairs = [RunTag(*pair) for pair in tags.items()]
        self.ask(f"setting tags of run {run_id}", lambda: self.client.log_batch(run_id, tags=pairs))

    def run(self, run_id: str) -> Run:
        """One run."""
        return self.ask(f"looking up the run {run_id}", lambda: self.client.get_run(run_id))

    def children(self, run_id: str) -> list[Run]:
        """The runs that are shown under another, newest first."""
        with mapped(f"looking up the runs under {run_id}"):
            experiment_id = self.client.get_run(run_id).info.experiment_id
            return self._search(experiment_id, f"tags.`{TAG_PARENT}` = '{run_id}'")

    def finished(self, experiment: str) -> list[Run]:
        """The runs of an experiment that have finished, newest first; empty for an unknown one."""
        with mapped(f"looking up the runs of {experiment}"):
            one = self.client.get_experiment_by_name(experiment)
            return [] if one is None else self._search(one.experiment_id, "attributes.status = 'FINISHED'")

    def _search(self, experiment_id: str, query: str) -> list[Run]:
        newest = ["attributes.start_time DESC"]
        return all_pages(self.client.search_runs, [experiment_id], query, order_by=newest)

    def file(self, run_id: str, path: str, folder: Path) -> Path | None:
        """A file that a run keeps, fetched into a folder; None where it keeps none of this name."""
        with mapped(f"fetching {path} of run {run_id}"):
            if not self._keeps(run_id, path):
                return None
            fetched = download_artifacts(
                run_id=run_id, artifact_path=path, dst_path=str(folder), tracking_uri=self._uri
            )
            return Path(fetched)

    def remove_file(self, run_id: str, path: str) -> None:
        """Delete a file that a run keeps, for good; nothing happens where it keeps none of this name."""
        with mapped(f"deleting {path} of run {run_id}"):
            if self._keeps(run_id, path):
                address = self.client.get_run(run_id).info.artifact_uri
                repository: Any = get_artifact_repository(address, tracking_uri=self._uri)
                repository.delete_artifacts(path)

    def _keeps(self, run_id: str, path: str) -> bool:
        parent = Path(path).parent.as_posix()
        there = self.client.list_artifacts(run_id, None if parent == "." else parent)
        return any(one.path == path for one in there)

    def ask(self, action: str, call: Callable[[], Answer]) -> Answer:
        """The answer of a call that may be repeated, waited for as long as this waits."""

        def call_once() -> Answer:
            with mapped(action):
                return call()

        return call_once() if self._wait_s is None else retry(action, call_once, self._wait_s)

    def _experiment_id(self, name: str) -> str:
        found: Experiment | None = self.client.get_experiment_by_name(name)
        if found is None:
            # Another trial may be quicker.
            with ignored("RESOURCE_ALREADY_EXISTS"):
                self.client.create_experiment(name)
            found = self.client.get_experiment_by_name(name)
        if found is None or found.lifecycle_stage != "active":
            remedy = "restore it in the MLflow UI, or remove it for good with `mlflow gc`"
            raise RegistryError(f"the experiment {name} was deleted", remedy=remedy)
        experiment_id = str(found.experiment_id)
        # The page of an experiment that others have made is filled in; outcomes are no trainings.
        page = {} if name == OUTCOMES_EXPERIMENT else experiment_page(experiment_id)
        for key, value in page.items():
            if key not in found.tags:
                self.client.set_experiment_tag(experiment_id, key, value)
        return experiment_id


class RunLog:
    """One run that is being written; not for sharing between threads.

    As a context manager it finishes the run, FAILED when an exception ends the block (KILLED when the
    exception is an interrupt).
    """

    def __init__(self, tracking: Tracking, run_id: str) -> None:
        self.run_id = run_id
        self._tracking, self._client = tracking, tracking.client
        self._is_open = False

    def open(self) -> None:
        """Mark the run as under way."""
        if not self._is_open:
            if self._client.get_run(self.run_id).info.status != "RUNNING":
                self._client.update_run(self.run_id, status="RUNNING")
            self._is_open = True

    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters; nested mappings become dotted names. A parameter keeps its first value for good."""
        entities = [Param(name, value) for name, value in flatten(params).items()]
        for first in range(0, len(entities), _MAX_PARAMS):
            batch = entities[first : first + _MAX_PARAMS]
            self._ask("logging parameters", partial(self._client.log_batch, self.run_id, params=batch))

    def metrics(self, metrics: Mapping[str, float], step: int, time_ms: int | None = None) -> None:
        """Send metrics of one step; points of the same step, value and ``time_ms`` (else now) are one."""
        at = time.time_ns() // 1_000_000 if time_ms is None else time_ms
        self.history([{"step": step, "time_ms": at, **metrics}])

    def history(self, rows: Iterable[Mapping[str, float]]) -> None:
        """Send metrics in batches, each row with its ``step`` and ``time_ms``."""
        points = [
            Metric(name, float(value), int(row["time_ms"]), int(row["step"]))
            for row in rows
            for name, value in row.items()
            if name not in ("step", "time_ms")
        ]
        for first in range(0, len(points), MAX_BATCH):
            batch = points[first : first + MAX_BATCH]
            self._ask("logging metrics", partial(self._client.log_batch, self.run_id, metrics=batch))

    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags; the last value holds."""
        pairs = [RunTag(name, value) for name, value in tags.items()]
        self._ask("setting tags", lambda: self._client.log_batch(self.run_id, tags=pairs))

    def artifact(self, path: Path, folder: str = "") -> None:
        """Keep a copy of a file, or of a folder's content, in a folder of the run."""
        if not path.exists():
            raise RegistryError("there is no such artifact", expected="a file or a folder", got=str(path))
        upload = self._client.log_artifacts if path.is_dir() else self._client.log_artifact
        self._ask(f"uploading {path.name}", lambda: upload(self.run_id, str(path), folder or None))

    def figure(self, fig: Any, name: str) -> None:
        """Keep a figure of matplotlib as ``figures/<name>.png``, and as the UI's image grid takes it."""
        key = name.removesuffix(".png")
        with tempfile.TemporaryDirectory(prefix="cspace-figure-") as folder:
            path = Path(folder) / f"{key}.png"
            fig.savefig(path, format="png")
            self.artifact(path, "figures")
            with PIL.Image.open(path) as image:
                upload = partial(self._client.log_image, self.run_id, image, key=key, step=0)
                self._ask(f"uploading {key}", upload)

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Keep columns of one length as ``tables/<name>.json``, which the UI compares."""
        path = f"tables/{name}.json"
        there = self._ask(f"uploading {path}", lambda: self._client.list_artifacts(self.run_id, "tables"))
        # MLflow would append to one that is there.
        if any(found.path == path for found in there):
            return
        with warnings.catch_warnings():
            # MLflow's use of pandas is nothing that a reader of the log can change.
            warnings.filterwarnings("ignore", "For backward compatibility, 'str' dtypes")
            upload = partial(self._client.log_table, self.run_id, dict(columns), path)
            self._ask(f"uploading {path}", upload)

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input, with the whole digest in its profile: MLflow cuts the field."""
        where, whole = json.dumps({"uri": source}), json.dumps({"sha256": digest})
        entity = Dataset(name, digest[:MAX_DIGEST], "local", where, profile=whole)
        inputs = [DatasetInput(entity, [InputTag("mlflow.data.context", context)])]

        def log() -> None:
            try:
                self._client.log_inputs(self.run_id, inputs)
            except MlflowException as error:
                if error.error_code != "BAD_REQUEST":
                    raise
                # Another run logged the same one in this moment, and MLflow wants each to be new or there.
                self._client.log_inputs(self.run_id, inputs)

        self._ask("logging the data set", log)

    def finish(self, status: RunStatus = "FINISHED") -> None:
        """End the run."""
        self._ask("ending", lambda: self._client.set_terminated(self.run_id, status))
        self._is_open = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.finish()
            return
        # The error that ended the block matters more than a server that is away or refuses as well.
        with suppress(RegistryError):
            self.finish("FAILED" if issubclass(kind, Exception) else "KILLED")

    def _ask(self, action: str, call: Callable[[], Answer]) -> Answer:
        def opened() -> Answer:
            self.open()
            return call()

        return self._tracking.ask(f"{action} of run {self.run_id}", opened)


@contextmanager
def ignored(error_code: str) -> Iterator[None]:
    """Go on after one of MLflow's errors."""
    try:
        yield
    except MlflowException as error:
        if error.error_code != error_code:
            raise


def all_pages(search: Callable[..., PagedList[Item]], *arguments: Any, **options: Any) -> list[Item]:
    """Everything that one of the client's searches finds."""
    found: list[Item] = get_results_from_paginated_fn(  # type: ignore[no-untyped-call]
        lambda number, token: search(*arguments, max_results=number, page_token=token, **options), _PAGE
    )
    return found


def experiment_page(experiment_id: str) -> Mapping[str, str]:
    """The experiment's tags: kind, description, views."""
    place = f"#/experiments/{experiment_id}/runs?{MLFLOW_TRAINING}&viewStateShareKey="
    lines = [f"- [{name}]({place}{name}): {words}; `{search}`" for name, (words, search, _) in VIEWS.items()]
    note = (
        "Learned samplers for motion planning. A training job is a run with a child for each of its trials; "
        "an evaluation is a child of the job whose version it evaluates, and leaves its headline on the job, "
        "on the version and on its logged model.\n\nSaved views of the runs:\n\n" + "\n".join(lines) + "\n\n"
        "Choose runs and press Compare for parameters and metrics side by side; the image grid of the chart "
        "view sets galleries beside each other, the evaluation view tables. Models compares versions."
    )
    tags = {"mlflow.experimentKind": "custom_model_development", NOTE: note}
    for name, (_, search, columns) in VIEWS.items():
        shown = ["attributes.`Created`", *columns]
        order = {"orderByKey": shown[0], "orderByAsc": False}
        tags[f"{VIEW}{name}"] = json.dumps({"searchFilter": search, **order, "selectedColumns": shown})
    return tags
