"""A real API process over a real MLflow server."""

from pathlib import Path
from typing import Any

import httpx
import pytest

from cspace.bundle import Bundle
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.raw import until
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.e2e, *MLFLOW_WARNINGS]
NAME = "cspace-sampler"


@pytest.mark.slow
def test_a_promotion_in_mlflow_is_served_without_a_restart_and_outlives_the_registry(
    tmp_path: Path, png: bytes, bundles: dict[str, Path]
) -> None:
    for name in ("mlflow", "api"):
        (tmp_path / name).mkdir()
    with mlflow_server(tmp_path / "mlflow") as uri:
        registry = ModelRegistry(uri)
        settings = {
            "MLFLOW_TRACKING_URI": uri,
            "CSPACE_MODEL_POLL_S": "0.1",
            "CSPACE_PRETRAINED_MODEL": str(bundles["shipped"]),
        }
        with (
            api_server(tmp_path / "api", settings) as address,
            Tracking(uri).start(NAME, "test") as run,
        ):
            assert model_of(address, png, NAME)["fallback"] is True
            for number, name in ((1, "plain"), (2, "other")):
                digest = Bundle.load(bundles[name]).digest
                registry.register(NAME, bundles[name], run.run_id, digest, {}, alias="champion")
                wait_for_version(address, png, number)
                found = model_of(address, png, f"{NAME}/1")
                assert (found["version"], found["run_id"]) == (1, run.run_id)
            listed = httpx.get(f"{address}/models", timeout=30).json()["models"]
            assert [item["reference"] for item in listed] == [f"{NAME}/2", f"{NAME}/1", "pretrained"]
    with api_server(tmp_path / "api", settings) as address:
        assert model_of(address, png, NAME)["version"] == 2
        assert httpx.get(f"{address}/health/ready", timeout=30).json()["registry"] == "unreachable"


def model_of(address: str, png: bytes, model: str) -> dict[str, Any]:
    data = {"model": model, "n": "3"}
    answer = httpx.post(f"{address}/sample", files={"image": png}, data=data, timeout=30)
    assert answer.status_code == 200, answer.text
    model_info: dict[str, Any] = answer.json()["model"]
    return model_info


def wait_for_version(address: str, png: bytes, number: int) -> None:
    until(lambda: bool(model_of(address, png, NAME)["version"] == number), 60.0)
