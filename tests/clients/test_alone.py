"""The client in an environment that holds it, OMPL, and nothing else of the project."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from tests.docs.tiny_api import DOCUMENTED
from tests.inference_api.server import ROOT, api_server

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]
DISCS = [(-1.93, -0.31, 1.0), (-0.76, -3.35, 1.0), (1.74, -0.79, 1.0)]
ABSENT = {"cspace-sampler", "onnxruntime", "torch", "ray", "mlflow", "fastapi", "pillow"}


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """As docs/client.md installs it: ``pip install './clients/python[ompl]'``."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, capture_output=True)
    interpreter = str(folder / "bin" / "python")
    command = [interpreter, "-m", "pip", "install", "--quiet", "--constraint", str(ROOT / "constraints.txt")]
    subprocess.run([*command, f"{ROOT}/clients/python[ompl]"], check=True)
    return interpreter


def run(python: str, *arguments: str, folder: Path) -> str:
    """What a command prints, away from the project's sources."""
    command = [python, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env={}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_first_script_of_the_documents_asks_a_running_api_and_plans_with_its_own_checker(
    python: str, tmp_path: Path
) -> None:
    listed = json.loads(run(python, "-m", "pip", "list", "--format", "json", folder=tmp_path))
    names = {entry["name"].lower() for entry in listed}
    assert not names & ABSENT
    assert {"cspace-client", "numpy", "httpx", "pydantic", "ompl"} <= names
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/client.md").read_text(), re.DOTALL)[:2]
    (tmp_path / "docs" / "images").mkdir(parents=True)
    shutil.copy(ROOT / "docs/images/discs.png", tmp_path / "docs/images")
    with api_server(tmp_path, {}) as url:
        script = "\n".join([*blocks, "print(found.path.tolist())"]).replace(DOCUMENTED, url)
        path = json.loads(run(python, "-c", script, folder=tmp_path).splitlines()[-1])
    assert len(path) >= 2
    scene = Scenario(TWO_LINK, tuple(Disc(*disc) for disc in DISCS))
    assert CollisionChecker(scene).valid_batch(path).all()
