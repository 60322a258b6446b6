"""The commands on a real server, as a user types them."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from services.planner.samples import LocalSampler
from tests.bundles import write_tiny_bundle
from tests.contracts.mlflow_server import mlflow_server
from tests.services.registry.test_signing import key

pytestmark = [pytest.mark.e2e, pytest.mark.slow]

NAME = "bench-arm"


@pytest.fixture(scope="module")
def uri(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with mlflow_server(tmp_path_factory.mktemp("mlflow")) as uri:
        yield uri


def models(uri: str, *arguments: str, code: int = 0) -> str:
    command = [sys.executable, "-m", "services.registry", "models", *arguments]
    environment = os.environ | {"MLFLOW_TRACKING_URI": uri}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.timeout(400)
def test_a_model_lives_through_all_commands(uri: str, tmp_path: Path) -> None:
    for number in (1, 2):
        bundle = write_tiny_bundle(tmp_path / f"bundle-{number}", scale=number / 4)
        assert f"{NAME}/{number} is the challenger" in models(uri, "import", str(bundle), NAME)
        models(uri, "promote", f"{NAME}/{number}", "--reason", f"reason {number}")
    assert f"{NAME}" in models(uri, "list")
    assert "version 1, version 2 before" in models(uri, "rollback", NAME, "--reason", "worse in the field")
    shown = models(uri, "show", NAME)
    assert f"{NAME}/1  champion" in shown
    assert "by hand: rolled back from 2: worse in the field" in shown
    history = models(uri, "history", NAME).splitlines()
    assert [line.split()[0] for line in history] == [f"{NAME}/{number}" for number in (1, 2, 1)]
    assert history[2].endswith("by hand: rolled back from 2: worse in the field")
    assert "there is no" in models(uri, "history", "unknown", code=2)
    assert "is in use" in models(uri, "delete", f"{NAME}/1", "--yes", code=2)
    private, public = key(tmp_path, "lab")
    assert "is signed" in models(uri, "sign", f"{NAME}/1", "--key", str(private))
    assert "signature by a key" in models(uri, "show", f"{NAME}/1")
    assert "private key" in models(uri, "sign", f"{NAME}/1", "--key", str(public), code=2)
    models(uri, "export", f"{NAME}/1", str(tmp_path / "out"))
    picture = np.full((48, 48, 3), 255, dtype=np.uint8)
    exported = LocalSampler(tmp_path / "out").sample(picture, 30, seed=7)
    assert (exported.digest, exported.samples.shape) == (Bundle.load(tmp_path / "bundle-1").digest, (30, 2))
    assert "elsewhere/1 is" in models(uri, "import", str(tmp_path / "out"), "elsewhere")
    # A signature is of one name and version.
    assert "signature" not in models(uri, "show", "elsewhere/1")
    models(uri, "promote", f"{NAME}@challenger", "--reason", "mended")
    assert "there is none" in models(uri, "rollback", "elsewhere", "--reason", "none", code=2)
