"""From a bundle to a version: a logged model of the run, its files, and the version that points to it."""

import tempfile
from collections.abc import Mapping
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import LoggedModel, LoggedModelOutput, LoggedModelStatus, Metric, Run
from mlflow.exceptions import MlflowException

from cspace.bundle import BundleSpec
from services.registry.metric_buffer import MAX_BATCH
from services.registry.mlflow_errors import mapped
from services.registry.mlflow_model import save_model

MODEL_TYPE = "sampler"


def create_version(
    client: MlflowClient,
    name: str,
    bundle_folder: Path,
    spec: BundleSpec,
    run_id: str,
    tags: Mapping[str, str],
) -> int:
    """Upload a bundle as a model of its run and make it the next version.

    Args:
        client: of the server.
        name: of the registered model, created when it is new.
        bundle_folder: sound.
        spec: the bundle's.
        run_id: the run that made it.
        tags: for the version and the logged model.

    Returns:
        The version's number.

    Raises:
        RegistryError: MLflow refuses; the logged model, if there is one by then, is marked as failed.
    """
    with mapped(f"registering {name} for run {run_id}"):
        model = _logged_model(client, name, bundle_folder, spec, run_id, tags)
        _ensure_registered(client, name)
        version = client.create_model_version(
            name,
            _source(client, model),
            run_id=run_id,
            tags=dict(tags),
            await_creation_for=0,
            model_id=model.model_id,
        )
        return int(version.version)


def _logged_model(
    client: MlflowClient,
    name: str,
    bundle_folder: Path,
    spec: BundleSpec,
    run_id: str,
    tags: Mapping[str, str],
) -> LoggedModel:
    run = client.get_run(run_id)
    model = client.create_logged_model(
        run.info.experiment_id, name, run_id, dict(tags), run.data.params, MODEL_TYPE
    )
    status = LoggedModelStatus.FAILED
    try:
        with tempfile.TemporaryDirectory(prefix="cspace-model-") as folder:
            saved = save_model(bundle_folder, spec, Path(folder), model.model_id, tags)
            client.log_model_artifacts(model.model_id, str(saved))
        client.log_outputs(run_id, [LoggedModelOutput(model.model_id, step=0)])
        _carry_metrics(client, run, model.model_id)
        status = LoggedModelStatus.READY
    finally:
        client.finalize_logged_model(model.model_id, status)
    return model


def _source(client: MlflowClient, model: LoggedModel) -> str:
    """The UI links a version to its logged model by the short form, which only a server can resolve."""
    if client.tracking_uri.startswith("http"):
        return f"models:/{model.model_id}"
    return str(model.artifact_location)


def _carry_metrics(client: MlflowClient, run: Run, model_id: str) -> None:
    """Show the run's last metrics and its data set on the logged model too.

    The run itself does not change: points that equal one that is there are dropped by MLflow.
    """
    used = [entry.dataset for entry in run.inputs.dataset_inputs] if run.inputs else []
    name, digest = (used[0].name, used[0].digest) if used else (None, None)
    points = []
    for key in run.data.metrics:
        last = max(
            client.get_metric_history(run.info.run_id, key), key=lambda point: (point.step, point.timestamp)
        )
        points.append(
            Metric(key, last.value, last.timestamp, last.step, model_id, name, digest, run.info.run_id)
        )
    for first in range(0, len(points), MAX_BATCH):
        client.log_batch(run.info.run_id, metrics=points[first : first + MAX_BATCH])


def _ensure_registered(client: MlflowClient, name: str) -> None:
    try:
        client.create_registered_model(name)
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS":
            raise
