"""A registration that was interrupted anywhere and is repeated leaves one version of one whole model."""

import pytest
import requests
from mlflow import MlflowClient
from mlflow.entities import LoggedModelStatus

from cspace.bundle import Bundle
from cspace.errors import RegistryUnavailableError
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.bundles import write_tiny_bundle
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS

STEPS = [
    "create_logged_model",
    "log_model_artifacts",
    "log_outputs",
    "finalize_logged_model",
    "create_registered_model",
    "create_model_version",
    "set_registered_model_alias",
]


@pytest.fixture
def uri(folder):
    return f"sqlite:///{folder / 'mlflow.db'}"


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("bundle") / "bundle"))


def interrupted(patch, step, *, carried_out):
    """Make the first call of a step fail, before or after it was carried out."""
    real, calls = getattr(MlflowClient, step), []

    def once(*args, **kwargs):
        calls.append(step)
        if len(calls) > 1:
            return real(*args, **kwargs)
        if carried_out:
            real(*args, **kwargs)
        raise requests.ConnectionError("reset")

    patch.setattr(MlflowClient, step, once)


# A step that was not carried out leaves what the one before it left.
@pytest.mark.parametrize(("step", "carried_out"), [(STEPS[0], False), *((step, True) for step in STEPS)])
def test_a_repeated_registration_leaves_one_version(uri, bundle, step, carried_out, monkeypatch):
    name = f"model-{step}-{carried_out}"
    run = Tracking(uri).start("registering", name)
    run.metrics({"loss": 1.0}, 1)
    run.finish()
    registry = ModelRegistry(uri)

    def register():
        return registry.register(name, bundle.folder, run.run_id, bundle.digest, {}, alias="challenger")

    interrupted(monkeypatch, step, carried_out=carried_out)
    with pytest.raises(RegistryUnavailableError):
        register()
    version = register()
    assert [one.number for one in registry.versions(name)] == [version.number]
    assert version.aliases == ("challenger",)
    client = MlflowClient(uri)
    experiment = client.get_run(run.run_id).info.experiment_id
    models = client.search_logged_models([experiment], f"source_run_id = '{run.run_id}'")
    assert [model.status for model in models] == [LoggedModelStatus.READY]


def test_a_call_that_was_repeated_below_makes_no_second_version(uri, bundle, monkeypatch, tmp_path):
    real = MlflowClient.create_model_version

    def twice(*args, **kwargs):
        real(*args, **kwargs)
        return real(*args, **kwargs)

    monkeypatch.setattr(MlflowClient, "create_model_version", twice)
    run = Tracking(uri).start("registering", "twice")
    registry = ModelRegistry(uri)
    version = registry.register("model-twice", bundle.folder, run.run_id, bundle.digest, {})
    assert [one.number for one in registry.versions("model-twice")] == [version.number] == [1]
    assert Bundle.load(registry.download(version, tmp_path / "bundle")).digest == bundle.digest
