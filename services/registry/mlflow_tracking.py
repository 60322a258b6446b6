"""Tracking on an MLflow server. Only explicit addresses and run ids: no current run, no global address."""

import time
from collections.abc import Callable, Mapping

from mlflow import MlflowClient
from mlflow.entities import Experiment
from mlflow.exceptions import MlflowException

from cspace.errors import RegistryError
from services.registry.mlflow_errors import mapped
from services.registry.mlflow_run import MlflowRun
from services.registry.tracking import RunLog

_PARENT = "mlflow.parentRunId"


class MlflowTracking:
    """The port :class:`services.registry.tracking.Tracking` on MLflow.

    Args:
        uri: of the tracking server, or ``sqlite:///…`` where the whole of mlflow is installed.
        buffer_size: number of metrics that are worth a call.
        buffer_age_s: how long a metric may wait for others.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        uri: str,
        *,
        buffer_size: int = 500,
        buffer_age_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        with mapped(f"opening {uri}"):
            self._client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        self._buffer_size = buffer_size
        self._buffer_age_s = buffer_age_s
        self._clock = clock

    def start(
        self,
        experiment: str,
        name: str,
        parent_run_id: str | None = None,
        tags: Mapping[str, str] | None = None,
    ) -> RunLog:
        """Start a run; see :meth:`services.registry.tracking.Tracking.start`."""
        parent = {} if parent_run_id is None else {_PARENT: parent_run_id}
        with mapped(f"starting the run {name}"):
            experiment_id = self._experiment_id(experiment)
            run = self._client.create_run(experiment_id, run_name=name, tags={**(tags or {}), **parent})
        return self._log(run.info.run_id, {}, 0)

    def resume(self, run_id: str, from_step: int | None = None) -> RunLog:
        """Go on with a run; see :meth:`services.registry.tracking.Tracking.resume`."""
        with mapped(f"resuming the run {run_id}"):
            run = self._client.get_run(run_id)
            held = {} if from_step is not None else self._last_steps(run_id, list(run.data.metrics))
            self._client.update_run(run_id, status="RUNNING")
        return self._log(run_id, held, from_step or 0)

    def _log(self, run_id: str, held: Mapping[str, int], from_step: int) -> MlflowRun:
        return MlflowRun(
            self._client,
            run_id,
            held=held,
            from_step=from_step,
            buffer_size=self._buffer_size,
            buffer_age_s=self._buffer_age_s,
            clock=self._clock,
        )

    def _last_steps(self, run_id: str, names: list[str]) -> dict[str, int]:
        return {
            name: max(point.step for point in self._client.get_metric_history(run_id, name)) for name in names
        }

    def _experiment_id(self, name: str) -> str:
        found = self._client.get_experiment_by_name(name)
        if found is None:
            try:
                return str(self._client.create_experiment(name))
            except MlflowException as error:
                # Another trial may have been quicker.
                if error.error_code != "RESOURCE_ALREADY_EXISTS":
                    raise
                found = self._client.get_experiment_by_name(name)
        return _living(name, found)


def _living(name: str, experiment: Experiment | None) -> str:
    if experiment is None or experiment.lifecycle_stage != "active":
        raise RegistryError(
            f"the experiment {name} was deleted",
            remedy="restore it in the MLflow UI, or remove it for good with `mlflow gc`",
        )
    return str(experiment.experiment_id)
