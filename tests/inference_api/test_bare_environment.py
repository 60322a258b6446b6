"""The API in an environment that holds its own dependencies and nothing else."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import httpx
import pytest

from cspace.bundle import Bundle
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS
from tests.inference_api.server import ROOT, api_server

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600), *MLFLOW_WARNINGS]
ABSENT = {"torch", "lightning", "ray", "scikit-learn", "scipy", "numba", "pandas", "mlflow", "ompl"}


def dependencies() -> list[str]:
    """What the project asks for when it is installed with the extra ``api``."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found: list[str] = [*project["dependencies"], *project["optional-dependencies"]["api"]]
    return [str(ROOT / "clients" / "python") if one == "cspace-client" else one for one in found]


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, capture_output=True)
    interpreter = str(folder / "bin" / "python")
    command = [interpreter, "-m", "pip", "install", "--quiet", "--constraint", str(ROOT / "constraints.txt")]
    subprocess.run([*command, *dependencies()], check=True)
    return interpreter


def test_the_api_serves_a_champion_with_nothing_but_its_own_dependencies(
    python: str, tmp_path: Path, png: bytes, bundles: dict[str, Path]
) -> None:
    listed = subprocess.run(
        [python, "-m", "pip", "list", "--format", "json"], check=True, capture_output=True, text=True
    )
    names = {entry["name"].lower().replace("_", "-") for entry in json.loads(listed.stdout)}
    assert not names & ABSENT
    assert {"fastapi", "onnx", "onnxruntime", "mlflow-skinny"} <= names
    for name in ("mlflow", "api"):
        (tmp_path / name).mkdir()
    with mlflow_server(tmp_path / "mlflow") as uri:
        run = Tracking(uri).start("cspace-sampler", "test")
        digest = Bundle.load(bundles["plain"]).digest
        ModelRegistry(uri).register(
            "cspace-sampler", bundles["plain"], run.run_id, digest, {}, alias="champion"
        )
        run.finish()
        settings = {"MLFLOW_TRACKING_URI": uri, "CSPACE_PRETRAINED_MODEL": str(bundles["shipped"])}
        with api_server(tmp_path / "api", settings, python=python) as address:
            answer = httpx.post(f"{address}/sample", files={"image": png}, timeout=30).json()
            assert len(answer["samples"]) == 300
            assert answer["model"]["digest"] == digest
            assert httpx.get(f"{address}/docs/assets/swagger-ui-bundle.js", timeout=30).status_code == 200
