"""Tracking on an MLflow server. Only explicit addresses and run ids: no current run, no global address."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Experiment, Metric, Run, RunTag
from mlflow.exceptions import MlflowException

from cspace.errors import RegistryError
from services.names import TAG_KEY
from services.registry.mlflow_errors import mapped
from services.registry.tracking.experiment import described
from services.registry.tracking.metric_buffer import Patience, points_of
from services.registry.tracking.mlflow_run import MlflowRun
from services.registry.tracking.port import ID, ID_LENGTH, NOTHING, RunLog
from services.registry.tracking.spool import Spool, spooled_runs
from services.registry.tracking.spooled_run import SpooledRun

_PARENT = "mlflow.parentRunId"


class MlflowTracking:
    """The port :class:`services.registry.tracking.port.Tracking` on MLflow.

    Args:
        uri: of the tracking server, or ``sqlite:///…`` where the whole of mlflow is installed.
        buffer_size: number of metrics that are worth a call.
        buffer_age_s: how long a metric may wait for others.
        clock: seconds, monotonic.
        spool_folder: where metrics wait while the server is away, see
            :class:`services.registry.tracking.spooled_run.SpooledRun`; None raises instead.
    """

    def __init__(
        self,
        uri: str,
        *,
        buffer_size: int = 500,
        buffer_age_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
        spool_folder: Path | None = None,
    ) -> None:
        with mapped("opening the tracking server"):
            self._client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self._patience = Patience(buffer_size, buffer_age_s, clock)
        self._spool_folder = spool_folder

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
        key: str | None = None,
    ) -> RunLog:
        """Start a run; see :meth:`services.registry.tracking.port.Tracking.start`."""
        parent = {} if parent_run_id is None else {_PARENT: parent_run_id}
        keyed = {} if key is None else {TAG_KEY: key}
        with mapped(f"starting the run {name}"):
            experiment_id = self._experiment_id(experiment)
            found = None if key is None else self._keyed(experiment_id, key)
            if found is not None:
                return self.resume(self._named(found))
            run = self._client.create_run(
                experiment_id, run_name=name, tags={**(tags or {}), **parent, **keyed}
            )
            run_id = self._named(run)
        if self._spool_folder is None:
            return self._log(run_id, {}, 0)
        return self._spooled(run_id, self._spool_folder)

    def resume(self, run_id: str, from_step: int | None = None) -> RunLog:
        """Go on with a run; see :meth:`services.registry.tracking.port.Tracking.resume`."""
        folder = self._spool_folder
        if folder is None:
            return self._reopened(run_id, from_step)
        return self._spooled(run_id, folder, from_step).open()

    def note(
        self, run_id: str, *, tags: Mapping[str, str] = NOTHING, metrics: Mapping[str, float] = NOTHING
    ) -> None:
        """Write onto a run; see :meth:`services.registry.tracking.port.Tracking.note`."""
        points = [Metric(one.name, one.value, one.time_ms, one.step) for one in points_of(metrics, 0)]
        with mapped(f"writing onto run {run_id}"):
            self._client.log_batch(run_id, points, tags=[RunTag(*pair) for pair in tags.items()])

    def deliver(self) -> None:
        """Send what waits in the spool's folder, for every run.

        Raises:
            RegistryUnavailableError: the server is away.
        """
        folder = self._spool_folder
        if folder is not None:
            for run_id in spooled_runs(folder):
                self._spooled(run_id, folder).deliver()

    def _keyed(self, experiment_id: str, key: str) -> Run | None:
        found = self._client.search_runs([experiment_id], f"tags.`{TAG_KEY}` = '{key}'", max_results=1)
        return found[0] if found else None

    def _named(self, run: Run) -> str:
        """The run's id, once the begin of it stands in the run's name where that wants it."""
        run_id, name = str(run.info.run_id), str(run.info.run_name)
        if ID in name:
            self._client.update_run(run_id, name=name.replace(ID, run_id[:ID_LENGTH]))
        return run_id

    def _spooled(self, run_id: str, folder: Path, from_step: int | None = None) -> SpooledRun:
        return SpooledRun(
            run_id,
            lambda: self._reopened(run_id, from_step),
            Spool(folder, run_id),
            self._patience,
        )

    def _reopened(self, run_id: str, from_step: int | None) -> MlflowRun:
        with mapped(f"resuming the run {run_id}"):
            run = self._client.get_run(run_id)
            held = {} if from_step is not None else self._last_steps(run_id, list(run.data.metrics))
            if run.info.status != "RUNNING":
                self._client.update_run(run_id, status="RUNNING")
        return self._log(run_id, held, from_step or 0)

    def _log(self, run_id: str, held: Mapping[str, int], from_step: int) -> MlflowRun:
        return MlflowRun(self._client, run_id, held=held, from_step=from_step, patience=self._patience)

    def _last_steps(self, run_id: str, names: list[str]) -> dict[str, int]:
        return {
            name: max(point.step for point in self._client.get_metric_history(run_id, name)) for name in names
        }

    def _experiment_id(self, name: str) -> str:
        found = self._client.get_experiment_by_name(name)
        if found is None:
            try:
                self._client.create_experiment(name)
            except MlflowException as error:
                # Another trial may have been quicker.
                if error.error_code != "RESOURCE_ALREADY_EXISTS":
                    raise
            found = self._client.get_experiment_by_name(name)
        return self._described(_living(name, found))

    def _described(self, experiment: Experiment) -> str:
        """The experiment's id, once its page says what it is; what somebody else wrote there stays."""
        experiment_id = str(experiment.experiment_id)
        ours = {key: value for key, value in described(experiment_id).items() if key not in experiment.tags}
        for key, value in ours.items():
            self._client.set_experiment_tag(experiment_id, key, value)
        return experiment_id


def _living(name: str, experiment: Experiment | None) -> Experiment:
    if experiment is None or experiment.lifecycle_stage != "active":
        raise RegistryError(
            f"the experiment {name} was deleted",
            remedy="restore it in the MLflow UI, or remove it for good with `mlflow gc`",
        )
    return experiment
