"""Tracking on an MLflow server. Only explicit addresses and run ids: no current run, no global address.

MLflow's own asynchronous logging loses what a killed process had queued. So metrics that the server does not
take are kept in a file of their run, :class:`Spool`, until it takes them.
"""

import json
import logging
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import PIL.Image
from mlflow import MlflowClient
from mlflow.artifacts import download_artifacts
from mlflow.entities import Dataset, DatasetInput, Experiment, InputTag, Metric, Param, Run, RunTag
from mlflow.exceptions import MlflowException
from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

from cspace.errors import RegistryError, RegistryUnavailableError
from services.names import (
    MLFLOW_TRAINING,
    NOTE,
    OUTCOMES_EXPERIMENT,
    TAG_JOB,
    TAG_KEY,
    TAG_MODEL,
    TAG_PRESET,
    TAG_STAGE,
)
from services.registry.mlflow_errors import all_pages, mapped, patiently
from services.registry.ports import ID, ID_LENGTH, FoundRun, RunLog, RunStatus, flatten

# Limits of the server: metrics and parameters in one call, and characters of a data set's digest.
MAX_BATCH, _MAX_PARAMS, MAX_DIGEST = 1000, 100, 36
# A server that hangs costs the client's patience at each try.
RETRY_S = 10.0
_PARENT = "mlflow.parentRunId"
_LOG = logging.getLogger("training")
Answer = TypeVar("Answer")


class MlflowTracking:
    """The port :class:`services.registry.ports.Tracking` on MLflow.

    Args:
        uri: of the tracking server, or ``sqlite:///…`` where the whole of mlflow is installed.
        buffer_size: number of metrics that are worth a call, which costs about as much for one as for many.
        buffer_age_s: how long a metric may wait for others. Looked at when the next one comes.
        clock: seconds, monotonic.
        spool_folder: where metrics and a run's end wait while the server is away; None raises instead.
        wait_s: how long all other calls wait for a server that is away; None raises at once.
    """

    def __init__(
        self,
        uri: str,
        *,
        buffer_size: int = 500,
        buffer_age_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
        spool_folder: Path | None = None,
        wait_s: float | None = None,
    ) -> None:
        with mapped("opening the tracking server"):
            self.client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self.buffer_size, self.buffer_age_s, self.clock = buffer_size, buffer_age_s, clock
        self._uri, self._spool_folder, self._wait_s = uri, spool_folder, wait_s

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
        key: str | None = None,
    ) -> RunLog:
        """Start a run; see :meth:`services.registry.ports.Tracking.start`."""
        parent = {} if parent_run_id is None else {_PARENT: parent_run_id}
        keyed = {} if key is None else {TAG_KEY: key}
        return self.ask(
            f"starting the run {name}",
            partial(self._start, experiment, name, {**(tags or {}), **parent, **keyed}, key),
        )

    def _start(self, experiment: str, name: str, tags: dict[str, str], key: str | None) -> RunLog:
        experiment_id = self._experiment_id(experiment)
        query = f"tags.`{TAG_KEY}` = '{key}'"
        found = [] if key is None else self.client.search_runs([experiment_id], query, max_results=1)
        run = found[0] if found else self.client.create_run(experiment_id, run_name=name, tags=tags)
        run_id, name = str(run.info.run_id), str(run.info.run_name)
        if ID in name:
            self.client.update_run(run_id, name=name.replace(ID, run_id[:ID_LENGTH]))
        return self.resume(run_id) if found else MlflowRun(self, run_id, self._spool(run_id), held={})

    def resume(self, run_id: str) -> RunLog:
        """Go on with a run; see :meth:`services.registry.ports.Tracking.resume`."""
        spool = self._spool(run_id)
        run = MlflowRun(self, run_id, spool)
        if spool is None:
            self.ask(f"resuming the run {run_id}", run.open)
        else:
            with suppress(RegistryUnavailableError):
                run.open()
        return run

    def note(self, run_id: str, tags: Mapping[str, str]) -> None:
        """Write onto a run; see :meth:`services.registry.ports.Tracking.note`."""
        pairs = [RunTag(*pair) for pair in tags.items()]
        self.ask(f"setting tags of run {run_id}", lambda: self.client.log_batch(run_id, tags=pairs))

    def deliver(self) -> None:
        """Send what waits in the spool's folder, for every run."""
        for run_id in spooled_runs(self._spool_folder) if self._spool_folder else ():
            run = MlflowRun(self, run_id, self._spool(run_id))
            self.ask("sending what waited", run.deliver)

    def run(self, run_id: str) -> FoundRun:
        """One run; see :meth:`services.registry.ports.Tracking.run`."""
        return self.ask(f"looking up the run {run_id}", lambda: _found(self.client.get_run(run_id)))

    def children(self, run_id: str) -> tuple[FoundRun, ...]:
        """The runs under another; see :meth:`services.registry.ports.Tracking.children`."""
        with mapped(f"looking up the runs under {run_id}"):
            experiment_id = self.client.get_run(run_id).info.experiment_id
            return self._search(experiment_id, f"tags.`{_PARENT}` = '{run_id}'")

    def finished(self, experiment: str) -> tuple[FoundRun, ...]:
        """The runs of an experiment; see :meth:`services.registry.ports.Tracking.finished`."""
        with mapped(f"looking up the runs of {experiment}"):
            one = self.client.get_experiment_by_name(experiment)
            return () if one is None else self._search(one.experiment_id, "attributes.status = 'FINISHED'")

    def _search(self, experiment_id: str, query: str) -> tuple[FoundRun, ...]:
        newest = ["attributes.start_time DESC"]
        found = all_pages(self.client.search_runs, [experiment_id], query, order_by=newest)
        return tuple(map(_found, found))

    def file(self, run_id: str, path: str, folder: Path) -> Path | None:
        """A file of a run; see :meth:`services.registry.ports.Tracking.file`."""
        with mapped(f"fetching {path} of run {run_id}"):
            if not self._keeps(run_id, path):
                return None
            return Path(
                download_artifacts(
                    run_id=run_id, artifact_path=path, dst_path=str(folder), tracking_uri=self._uri
                )
            )

    def remove_file(self, run_id: str, path: str) -> None:
        """Delete a file of a run; see :meth:`services.registry.ports.Tracking.remove_file`."""
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

        return call_once() if self._wait_s is None else patiently(action, call_once, self._wait_s)

    def _spool(self, run_id: str) -> "Spool | None":
        return None if self._spool_folder is None else Spool(self._spool_folder, run_id)

    def _experiment_id(self, name: str) -> str:
        """Of an experiment, made where it is new; its page is filled in where others left it empty."""
        found: Experiment | None = self.client.get_experiment_by_name(name)
        if found is None:
            try:
                self.client.create_experiment(name)
            except MlflowException as error:
                # Another trial may have been quicker.
                if error.error_code != "RESOURCE_ALREADY_EXISTS":
                    raise
            found = self.client.get_experiment_by_name(name)
        if found is None or found.lifecycle_stage != "active":
            raise RegistryError(
                f"the experiment {name} was deleted",
                remedy="restore it in the MLflow UI, or remove it for good with `mlflow gc`",
            )
        experiment_id = str(found.experiment_id)
        # Its runs are no trainings.
        page = {} if name == OUTCOMES_EXPERIMENT else described(experiment_id)
        for key, value in page.items():
            if key not in found.tags:
                self.client.set_experiment_tag(experiment_id, key, value)
        return experiment_id


class MlflowRun(RunLog):
    """The port :class:`services.registry.ports.RunLog` on MLflow; made by :class:`MlflowTracking`.

    With a spool, metrics and the run's end never raise RegistryUnavailableError. What waits in the spool, of
    this process or of an earlier one, is delivered first, and steps that the server holds already are
    dropped.

    Args:
        tracking: its server.
        run_id: of the run.
        spool: of the run.
        held: metric to the last step that the run has; earlier ones are dropped. None asks the server first.
    """

    def __init__(
        self,
        tracking: MlflowTracking,
        run_id: str,
        spool: "Spool | None",
        held: dict[str, int] | None = None,
    ) -> None:
        self._tracking, self.run_id, self._spool, self._held = tracking, run_id, spool, held
        self._client = tracking.client
        self._points: list[Metric] = []
        self._since_s = 0.0
        self._away_until_s = float("-inf")

    def open(self) -> dict[str, int]:
        """The last steps that the server has, asked once; from then on the run is under way again."""
        if self._held is None:
            with mapped(f"resuming the run {self.run_id}"):
                run = self._client.get_run(self.run_id)
                held = {}
                for name in run.data.metrics:
                    points = self._client.get_metric_history(self.run_id, name)
                    held[name] = max(point.step for point in points)
                if run.info.status != "RUNNING":
                    self._client.update_run(self.run_id, status="RUNNING")
            self._held = held
        return self._held

    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters, flattened."""
        entities = [Param(name, value) for name, value in flatten(params).items()]
        for first in range(0, len(entities), _MAX_PARAMS):
            batch = entities[first : first + _MAX_PARAMS]
            self._ask("logging parameters", partial(self._client.log_batch, self.run_id, params=batch))

    def metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Log metrics: buffered, then sent, or kept on disk."""
        now = self._tracking.clock()
        if not self._points:
            self._since_s = now
        self._points += points_of(metrics, step)
        waited_s = now - self._since_s
        if len(self._points) >= self._tracking.buffer_size or waited_s >= self._tracking.buffer_age_s:
            self.flush()

    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags."""
        pairs = [RunTag(name, value) for name, value in tags.items()]
        self._ask("setting tags", lambda: self._client.log_batch(self.run_id, tags=pairs))

    def artifact(self, path: Path, folder: str = "") -> None:
        """Upload a file, or a folder's content."""
        if not path.exists():
            raise RegistryError("there is no such artifact", expected="a file or a folder", got=str(path))
        upload = self._client.log_artifacts if path.is_dir() else self._client.log_artifact
        self._ask(f"uploading {path.name}", lambda: upload(self.run_id, str(path), folder or None))

    def figure(self, fig: Any, name: str) -> None:
        """Render a figure as PNG and upload it, also as the UI's image grid takes it."""
        key = name.removesuffix(".png")
        with tempfile.TemporaryDirectory(prefix="cspace-figure-") as folder:
            path = Path(folder) / f"{key}.png"
            fig.savefig(path, format="png")
            self.artifact(path, "figures")
            with PIL.Image.open(path) as image:
                upload = partial(self._client.log_image, self.run_id, image, key=key, step=0)
                self._ask(f"uploading {key}", upload)

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Upload a table, once: MLflow would append to one that is there."""
        import pyarrow as pa  # noqa: PLC0415 - with pandas, which comes with the whole of mlflow alone
        from pyarrow import parquet  # noqa: PLC0415 - as above

        path = f"tables/{name}.json"
        there = self._ask(f"uploading {path}", lambda: self._client.list_artifacts(self.run_id, "tables"))
        if any(found.path == path for found in there):
            return
        with tempfile.TemporaryDirectory(prefix="cspace-table-") as folder:
            whole = Path(folder) / f"{name}.parquet"
            parquet.write_table(pa.table(dict(columns)), whole)
            self.artifact(whole, "tables")
        with warnings.catch_warnings():
            # MLflow's use of pandas is nothing that a reader of the log can change.
            warnings.filterwarnings("ignore", "For backward compatibility, 'str' dtypes")
            upload = partial(self._client.log_table, self.run_id, dict(columns), path)
            self._ask(f"uploading {path}", upload)

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input, with the whole digest in its profile: MLflow cuts the field."""
        entity = Dataset(
            name=name,
            digest=digest[:MAX_DIGEST],
            source_type="local",
            source=json.dumps({"uri": source}),
            profile=json.dumps({"sha256": digest}),
        )
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

    def flush(self) -> None:
        """Send the metrics that wait, or keep them on disk."""
        while self._points:
            batch = self._points[:MAX_BATCH]
            self._send_or_keep(batch)
            del self._points[: len(batch)]

    def deliver(self) -> None:
        """Send what waits on disk, and end the run if it had ended.

        Raises:
            RegistryUnavailableError: the server is away.
        """
        if not self._spool:
            return
        points, ending = self._spool.read()
        self._held = None
        held = dict(self.open())
        fresh = []
        # Attempts that all had to wait have repeated steps: a step's first value stays.
        for point in points:
            if point.step > held.get(point.key, -1):
                held[point.key] = point.step
                fresh.append(point)
        self._send(fresh)
        if ending is not None:
            self._end(ending)
        self._spool.clear()
        # What was delivered is held from here on, and a run that had ended goes on with the next call.
        self._held = None

    def finish(self, status: RunStatus = "FINISHED") -> None:
        """Send what waits and end the run, or keep its end on disk."""
        self.flush()
        ending = Ending(status, time.time_ns() // 1_000_000)
        try:
            self.deliver()
            self._end(ending)
        except RegistryUnavailableError:
            if self._spool is None:
                raise
            self._spool.end(ending)

    def _send_or_keep(self, points: list[Metric]) -> None:
        if self._spool is None:
            self._send(self._new(points))
            return
        if self._tracking.clock() >= self._away_until_s:
            try:
                self.deliver()
                self._send(self._new(points))
            except RegistryUnavailableError as error:
                if not self._spool:
                    _LOG.warning("run %s: metrics wait on disk: %s", self.run_id, error)
                self._away_until_s = self._tracking.clock() + RETRY_S
            else:
                return
        self._spool.add(points)

    def _new(self, points: Sequence[Metric]) -> list[Metric]:
        held = self.open()
        return [point for point in points if point.step > held.get(point.key, -1)]

    def _send(self, points: Sequence[Metric]) -> None:
        with mapped(f"logging metrics of run {self.run_id}"):
            for first in range(0, len(points), MAX_BATCH):
                self._client.log_batch(self.run_id, metrics=points[first : first + MAX_BATCH])

    def _end(self, ending: "Ending") -> None:
        with mapped(f"ending the run {self.run_id}"):
            self._client.set_terminated(self.run_id, ending.status, ending.time_ms)

    def _ask(self, action: str, call: Callable[[], Answer]) -> Answer:
        def opened() -> Answer:
            self.open()
            return call()

        return self._tracking.ask(f"{action} of run {self.run_id}", opened)


class Ending(NamedTuple):
    """How a run ended, and when, in milliseconds since 1970-01-01 UTC."""

    status: RunStatus
    time_ms: int


class Spool:
    """What a run could not send, in a file until it can: metrics, and how the run ended.

    Each batch is written in one piece, one JSON list a line. A process that is killed as it writes leaves a
    line without its end, which is dropped: a checkpoint is written after the batches before it, so that such
    a batch is logged again.

    Args:
        folder: of all runs' files, made by the first that has to wait.
        run_id: of the run.
    """

    def __init__(self, folder: Path, run_id: str) -> None:
        self._path = folder / f"{Path(run_id).name}.jsonl"

    def add(self, points: Sequence[Metric]) -> None:
        """Keep metrics."""
        self._write([(point.key, point.value, point.timestamp, point.step) for point in points])

    def end(self, ending: Ending) -> None:
        """Keep how the run ended."""
        self._write([ending])

    def read(self) -> tuple[list[Metric], Ending | None]:
        """Everything that waits: metrics in the order of logging, and how the run ended if it did."""
        points: list[Metric] = []
        ending: Ending | None = None
        for line in self._path.read_text(encoding="utf-8").splitlines() if self else ():
            with suppress(ValueError):
                row = json.loads(line)
                if len(row) == len(Ending._fields):
                    ending = Ending(*row)
                else:
                    # A run that was ended and goes on has not ended.
                    points, ending = [*points, Metric(*row)], None
        return points, ending

    def clear(self) -> None:
        """Everything was delivered."""
        self._path.unlink(missing_ok=True)

    def __bool__(self) -> bool:
        return self._path.exists()

    def _write(self, rows: Sequence[tuple[Any, ...]]) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        text = "".join(json.dumps(row) + "\n" for row in rows)
        with self._path.open("a", encoding="utf-8") as file:
            # A line that a killed process left without its end must not swallow the next one.
            file.write(text if file.tell() == 0 else "\n" + text)
            file.flush()
            os.fsync(file.fileno())


def spooled_runs(folder: Path) -> tuple[str, ...]:
    """Ids of the runs for which something waits."""
    return tuple(sorted(path.stem for path in folder.glob("*.jsonl")))


def points_of(metrics: Mapping[str, float], step: int) -> list[Metric]:
    """The metrics of one step, logged now."""
    now_ms = time.time_ns() // 1_000_000
    return [Metric(name, float(value), now_ms, step) for name, value in metrics.items()]


def _found(run: Run) -> FoundRun:
    if run.info.lifecycle_stage != "active":
        raise RegistryError(f"the run {run.info.run_id} was deleted", remedy="restore it in the MLflow UI")
    info, tags, metrics = run.info, dict(run.data.tags), dict(run.data.metrics)
    return FoundRun(
        str(info.run_id), str(info.run_name), tags.get(_PARENT), tags, metrics, int(info.start_time)
    )


# What the UI keeps of a saved search when somebody presses Share: a tag of the experiment, opened by
# ``viewStateShareKey`` in the address.
VIEW = "mlflow.sharedViewState."
_QUALITY = ("precision", "served_precision", "coverage", "served_coverage", "edr", "planning_success")


class View(NamedTuple):
    """A saved search of runs: what it shows, which runs in MLflow's words, and the columns."""

    words: str
    search: str
    columns: Mapping[str, Sequence[str]]

    def state(self) -> str:
        """The state of the UI, as its tag holds it."""
        columns = {"attributes": ["Created"], **self.columns}
        return json.dumps(
            {
                "searchFilter": self.search,
                "orderByKey": "attributes.`Created`",
                "orderByAsc": False,
                "selectedColumns": [f"{kind}.`{name}`" for kind, names in columns.items() for name in names],
            }
        )


VIEWS = {
    "jobs": View(
        "every training job with its settings and the figures of its last evaluation",
        f"tags.{TAG_STAGE} LIKE '%-train'",
        {
            "tags": [TAG_MODEL],
            "params": ["seed", "clusters.form", "local.steps"],
            "metrics": [f"validation/{name}" for name in _QUALITY],
        },
    ),
    "trials": View(
        "the local trials of all jobs, with the parameters and last losses of each",
        f"tags.{TAG_STAGE} = 'local'",
        {
            "tags": [TAG_JOB, TAG_PRESET],
            "params": ["cluster", "share_of_data", "steps", "seed", "parameters"],
            "metrics": ["critic_loss", "wasserstein_estimate", "generator_loss", "steps_per_s"],
        },
    ),
    "evaluations": View(
        "every evaluation of a registered version, validation and test",
        f"tags.{TAG_STAGE} = 'evaluation'",
        {
            "tags": [TAG_MODEL, "promoted"],
            "params": ["seed", "scenarios"],
            "metrics": [f"{split}/{name}" for split in ("validation", "test") for name in _QUALITY[:5]],
        },
    ),
    "planning": View(
        "the planning benchmarks",
        f"tags.{TAG_STAGE} = 'planning-benchmark'",
        {"tags": ["protocol"], "params": ["setting.seed"]},
    ),
}


def described(experiment_id: str) -> Mapping[str, str]:
    """The experiment's tags: kind, description, views."""
    place = f"#/experiments/{experiment_id}/runs?{MLFLOW_TRAINING}&viewStateShareKey="
    lines = "\n".join(
        f"- [{name}]({place}{name}): {view.words}; `{view.search}`" for name, view in VIEWS.items()
    )
    note = (
        "Learned samplers for motion planning. A training job is a run with a child for each of its trials; "
        "an evaluation is a child of the job whose version it judges, and leaves its headline on the job, on "
        "the version and on its logged model.\n\n"
        f"Saved views of the runs:\n\n{lines}\n\n"
        "Choose runs and press Compare for parameters and metrics side by side; the image grid of the chart "
        "view sets galleries beside each other, the evaluation view tables. Models compares versions."
    )
    kind = {"mlflow.experimentKind": "custom_model_development", NOTE: note}
    return kind | {f"{VIEW}{name}": view.state() for name, view in VIEWS.items()}
