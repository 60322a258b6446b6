"""What only MLflow can show: which run and which data a version comes from."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from mlflow import MlflowClient

from cspace.bundle import Bundle
from services.registry.entities import ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.bundles import write_tiny_bundle
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS
DIGEST = "fedcba9876543210" * 4


@dataclass(frozen=True)
class Registered:
    """A version on a real store."""

    uri: str
    version: ModelVersion


@pytest.fixture(scope="module", params=["database", pytest.param("server", marks=pytest.mark.e2e)])
def registered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Registered:
    uri = request.getfixturevalue(f"{request.param}_uri")
    return _register(uri, tmp_path_factory.mktemp("lineage") / "bundle", "lineage")


def test_a_version_leads_to_its_run_and_to_the_data(registered: Registered) -> None:
    client = MlflowClient(tracking_uri=registered.uri, registry_uri=registered.uri)
    found = client.get_model_version(registered.version.name, str(registered.version.number))
    run = client.get_run(found.run_id)
    [output] = run.outputs.model_outputs
    model = client.get_logged_model(output.model_id)
    assert model.model_id in found.source
    assert model.source_run_id == found.run_id
    assert model.status == "READY"
    assert model.params == run.data.params == {"seed": "7"}
    assert [entry.dataset.digest for entry in run.inputs.dataset_inputs] == [DIGEST[:36]]
    [metric] = model.metrics
    assert (metric.key, metric.value, metric.step) == ("precision", 0.84, 1)
    assert (metric.dataset_name, metric.dataset_digest) == ("own", DIGEST[:36])
    history = client.get_metric_history(found.run_id, "precision")
    assert [(point.step, point.value) for point in history] == [(0, 0.7), (1, 0.84)]

    # What is shown later stands on the version's page and on its logged model.
    shown = ({"validation/edr": 0.25}, "## promoted", "planar scenes, seed 0", DIGEST)
    ModelRegistry(registered.uri).show(registered.version, *shown)
    page = client.get_model_version(registered.version.name, str(registered.version.number))
    assert page.description == "## promoted"
    metrics = {metric.key: metric for metric in client.get_logged_model(output.model_id).metrics}
    metric = metrics["validation/edr"]
    assert (metric.value, metric.dataset_name) == (0.25, "planar scenes, seed 0")
    assert metric.dataset_digest == DIGEST[:36]


def _register(uri: str, folder: Path, name: str) -> Registered:
    bundle = Bundle.load(write_tiny_bundle(folder))
    with Tracking(uri).start("lineage", "global") as run:
        run.params({"seed": 7})
        run.metrics({"precision": 0.7}, 0)
        run.metrics({"precision": 0.84}, 1)
        run.dataset("own", DIGEST, "data/own", "training")
        made = ModelRegistry(uri).register(
            name, folder, run.run_id, bundle.digest, {"data_digest": DIGEST}, alias="challenger"
        )
    return Registered(uri, made)
