"""From a bundle to a version: a logged model of the run, its files, and the version that points to it.

Each step may be the last one of a process, and each call may be carried out without an answer. So what an
interrupted attempt has finished is taken over, what it left half is deleted, and a version that a call
made twice because it was repeated is one again.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import LoggedModel, LoggedModelOutput, LoggedModelStatus, Metric, Run
from mlflow.exceptions import MlflowException

from cspace.bundle import BundleSpec
from services.names import TAG_DIGEST
from services.registry.mlflow_errors import mapped
from services.registry.models.mlflow_model import save_model
from services.registry.tracking.metric_buffer import MAX_BATCH

MODEL_TYPE = "sampler"


def create_version(
    client: MlflowClient,
    name: str,
    bundle_folder: Path,
    spec: BundleSpec,
    run_id: str,
    tags: Mapping[str, str],
) -> int:
    """Upload a bundle as a model of its run and make it the next version, once.

    Args:
        client: of the server.
        name: of the registered model, created when it is new.
        bundle_folder: sound.
        spec: the bundle's.
        run_id: the run that made it.
        tags: for the version and the logged model, the digest among them.

    Returns:
        The version's number.

    Raises:
        RegistryError: MLflow refuses; the logged model, if there is one by then, is marked as failed.
    """
    with mapped(f"registering {name} for run {run_id}"):
        run = client.get_run(run_id)
        model = _finished_model(client, name, run, tags[TAG_DIGEST])
        if model is None:
            model = _logged_model(client, name, bundle_folder, spec, run, tags)
        _ensure_registered(client, name)
        client.create_model_version(
            name,
            _source(client, model),
            run_id=run_id,
            tags=dict(tags),
            await_creation_for=0,
            model_id=model.model_id,
        )
        return _only_version(client, name, run_id, tags[TAG_DIGEST])


def logged_model(client: MlflowClient, name: str, run: Run, digest: str) -> LoggedModel | None:
    """The whole model of a bundle that a run has logged; None without one."""
    whole = [one for one in _logged(client, name, run, digest) if one.status == LoggedModelStatus.READY]
    return whole[0] if whole else None


def _finished_model(client: MlflowClient, name: str, run: Run, digest: str) -> LoggedModel | None:
    """The model that an interrupted attempt has uploaded whole; those that it has not are deleted."""
    for model in _logged(client, name, run, digest):
        if model.status != LoggedModelStatus.READY:
            client.delete_logged_model(model.model_id)
    return logged_model(client, name, run, digest)


def _logged(client: MlflowClient, name: str, run: Run, digest: str) -> list[LoggedModel]:
    found = client.search_logged_models(
        [run.info.experiment_id], f"source_run_id = '{run.info.run_id}' AND name = '{name}'"
    )
    return [model for model in found if model.tags.get(TAG_DIGEST) == digest]


def _only_version(client: MlflowClient, name: str, run_id: str, digest: str) -> int:
    """The version of a run and a digest; later ones of the same, which a repeated call has made, go."""
    found = client.search_model_versions(f"name='{name}' AND run_id='{run_id}'")
    numbers = sorted(int(one.version) for one in found if one.tags.get(TAG_DIGEST) == digest)
    for number in numbers[1:]:
        client.delete_model_version(name, str(number))
    return numbers[0]


def _logged_model(
    client: MlflowClient,
    name: str,
    bundle_folder: Path,
    spec: BundleSpec,
    run: Run,
    tags: Mapping[str, str],
) -> LoggedModel:
    run_id = run.info.run_id
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
