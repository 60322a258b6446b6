"""One run on an MLflow server."""

import json
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import PIL.Image
from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag
from mlflow.exceptions import MlflowException

from cspace.errors import RegistryError
from services.registry.mlflow_errors import mapped
from services.registry.tracking.metric_buffer import MAX_BATCH, MetricBuffer, MetricPoint, Patience, points_of
from services.registry.tracking.parameters import flatten
from services.registry.tracking.port import Picture, RunStatus
from services.registry.tracking.run_block import RunBlock

# Limits of the server: parameters in one call, and characters of a data set's digest.
_MAX_PARAMS = 100
_MAX_DIGEST = 36
_CONTEXT = "mlflow.data.context"
_TABLES = "tables"


class MlflowRun(RunBlock):
    """The port :class:`services.registry.tracking.port.RunLog` on MLflow; made by ``MlflowTracking``.

    Args:
        client: of the server.
        run_id: of the run.
        held: metric to the last step that the run has already; earlier ones are dropped.
        from_step: metrics of earlier steps are dropped.
        patience: when metrics are sent.
    """

    def __init__(
        self,
        client: MlflowClient,
        run_id: str,
        *,
        held: Mapping[str, int],
        from_step: int,
        patience: Patience,
    ) -> None:
        self._client, self._run_id = client, run_id
        self._held, self._from_step = held, from_step
        self._buffer = MetricBuffer(self._send, patience)

    @property
    def run_id(self) -> str:
        """The run's id."""
        return self._run_id

    def params(self, params: Mapping[str, Any]) -> None:
        """Log parameters, flattened."""
        entities = [Param(name, value) for name, value in flatten(params).items()]
        with self._mapped("logging parameters"):
            for first in range(0, len(entities), _MAX_PARAMS):
                self._client.log_batch(self._run_id, params=entities[first : first + _MAX_PARAMS])

    def metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Log metrics, buffered."""
        self._buffer.add(self._wanted(points_of(metrics, step)))

    def points(self, points: Sequence[MetricPoint]) -> None:
        """Send metrics that were logged before, at once."""
        wanted = self._wanted(points)
        for first in range(0, len(wanted), MAX_BATCH):
            self._send(wanted[first : first + MAX_BATCH])

    def tags(self, tags: Mapping[str, str]) -> None:
        """Set tags."""
        with self._mapped("setting tags"):
            self._client.log_batch(self._run_id, tags=[RunTag(name, value) for name, value in tags.items()])

    def artifact(self, path: Path, folder: str = "") -> None:
        """Upload a file, or a folder's content."""
        if not path.exists():
            raise RegistryError("there is no such artifact", expected="a file or a folder", got=str(path))
        upload = self._client.log_artifacts if path.is_dir() else self._client.log_artifact
        with self._mapped(f"uploading {path.name}"):
            upload(self._run_id, str(path), folder or None)

    def figure(self, fig: Picture, name: str) -> None:
        """Render a figure as PNG and upload it, also as the UI's image grid takes it."""
        key = name.removesuffix(".png")
        with tempfile.TemporaryDirectory(prefix="cspace-figure-") as folder:
            path = Path(folder) / f"{key}.png"
            fig.savefig(path, format="png")
            self.artifact(path, "figures")
            with PIL.Image.open(path) as image, self._mapped(f"uploading {key}"):
                self._client.log_image(self._run_id, image, key=key, step=0)

    def table(self, columns: Mapping[str, Sequence[Any]], name: str) -> None:
        """Upload a table, once: MLflow would append to one that is there."""
        import pyarrow as pa  # noqa: PLC0415 - with pandas, which comes with the whole of mlflow alone
        from pyarrow import parquet  # noqa: PLC0415 - as above

        path = f"{_TABLES}/{name}.json"
        with self._mapped(f"uploading {path}"):
            if any(found.path == path for found in self._client.list_artifacts(self._run_id, _TABLES)):
                return
        with tempfile.TemporaryDirectory(prefix="cspace-table-") as folder:
            whole = Path(folder) / f"{name}.parquet"
            parquet.write_table(pa.table(dict(columns)), whole)
            self.artifact(whole, _TABLES)
        with self._mapped(f"uploading {path}"), warnings.catch_warnings():
            # MLflow's use of pandas is nothing that a reader of the log can change.
            warnings.filterwarnings("ignore", "For backward compatibility, 'str' dtypes")
            self._client.log_table(self._run_id, dict(columns), path)

    def dataset(self, name: str, digest: str, source: str, context: str) -> None:
        """Log a data set as an input.

        MLflow keeps 36 characters of a digest; the whole of it goes into the profile.
        """
        entity = Dataset(
            name=name,
            digest=digest[:_MAX_DIGEST],
            source_type="local",
            source=json.dumps({"uri": source}),
            profile=json.dumps({"sha256": digest}),
        )
        entry = DatasetInput(entity, [InputTag(_CONTEXT, context)])
        with self._mapped("logging the data set"):
            try:
                self._client.log_inputs(self._run_id, [entry])
            except MlflowException as error:
                if error.error_code != "BAD_REQUEST":
                    raise
                # Another run logged the same one in this moment, and MLflow wants each to be new or there.
                self._client.log_inputs(self._run_id, [entry])

    def flush(self) -> None:
        """Send the metrics that wait."""
        self._buffer.flush()

    def finish(self, status: RunStatus = "FINISHED") -> None:
        """Send what waits and end the run."""
        self.flush()
        self.end(status)

    def end(self, status: RunStatus, time_ms: int | None = None) -> None:
        """End the run, at a time that is past or now."""
        with self._mapped("ending the run"):
            self._client.set_terminated(self._run_id, status, time_ms)

    def _wanted(self, points: Sequence[MetricPoint]) -> list[MetricPoint]:
        return [
            point
            for point in points
            if point.step >= self._from_step and point.step > self._held.get(point.name, -1)
        ]

    def _send(self, points: Sequence[MetricPoint]) -> None:
        entities = [Metric(point.name, point.value, point.time_ms, point.step) for point in points]
        with self._mapped("logging metrics"):
            self._client.log_batch(self._run_id, metrics=entities)

    def _mapped(self, action: str) -> AbstractContextManager[None]:
        return mapped(f"{action} of run {self._run_id}")
