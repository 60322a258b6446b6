"""The client in an environment that holds it, OMPL, and nothing else of the project."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from inference_api.settings import PRETRAINED_FOLDER
from tests.inference_api.server import ROOT, api_server

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]
EXAMPLES = ROOT / "clients" / "python" / "examples"
DISCS = [(-1.93, -0.31, 1.0), (-0.76, -3.35, 1.0), (1.74, -0.79, 1.0)]
ABSENT = {"cspace-sampler", "onnxruntime", "torch", "ray", "mlflow", "fastapi", "pillow"}


def environment(folder: Path, *packages: str) -> str:
    """The interpreter of a new environment."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True, capture_output=True)
    interpreter = str(folder / "bin" / "python")
    command = [interpreter, "-m", "pip", "install", "--quiet", "--constraint", str(ROOT / "constraints.txt")]
    subprocess.run([*command, *packages], check=True)
    return interpreter


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """As docs/client.md installs it: ``pip install './clients/python[ompl]'``."""
    return environment(tmp_path_factory.mktemp("environment"), f"{ROOT}/clients/python[ompl]")


def run(python: str, *arguments: str, folder: Path) -> str:
    """What a command prints, away from the project's sources."""
    command = [python, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env={}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_script_of_its_own_asks_a_running_api_and_plans_with_ompl_and_its_own_checker(
    python: str, tmp_path: Path
) -> None:
    listed = json.loads(run(python, "-m", "pip", "list", "--format", "json", folder=tmp_path))
    names = {entry["name"].lower() for entry in listed}
    assert not names & ABSENT
    assert {"cspace-client", "numpy", "httpx", "pydantic", "ompl"} <= names
    (tmp_path / "api").mkdir()
    with api_server(tmp_path / "api", {}) as url:
        script, picture = str(EXAMPLES / "plan_among_discs.py"), str(EXAMPLES / "discs.png")
        printed = run(python, script, url, picture, folder=tmp_path).splitlines()
    drawn = next(line for line in printed if "learned samples drawn" in line)
    assert int(drawn.split()[0]) > 0
    path = [[float(angle) for angle in line.split()] for line in printed[printed.index(drawn) + 1 :]]
    assert len(path) >= 2
    scene = Scenario(TWO_LINK, tuple(Disc(*disc) for disc in DISCS))
    assert CollisionChecker(scene).valid_batch(path).all()


def test_a_bundle_wants_the_project_and_says_so(python: str, tmp_path: Path) -> None:
    code = """
from cspace_client import LocalError
from cspace_client.local import LocalClient
try:
    LocalClient("bundle")
except LocalError as error:
    print(error)
"""
    assert "install onnxruntime and cspace-sampler" in run(python, "-c", code, folder=tmp_path)


def test_a_bundle_is_read_where_the_project_and_a_runtime_are_beside_it(tmp_path: Path) -> None:
    """As docs/client.md installs it, from a copy: pip leaves files where it builds."""
    for name in ("cspace", "inference_api", "services", "training"):
        shutil.copytree(ROOT / name, tmp_path / "sources" / name)
    for name in ("LICENSE", "README.md", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path / "sources")
    python = environment(tmp_path / "environment", str(tmp_path / "sources"), f"{ROOT}/clients/python[local]")
    code = f"""
import pathlib
from cspace_client.local import LocalClient
picture = pathlib.Path({str(EXAMPLES / "discs.png")!r}).read_bytes()
print(LocalClient({str(PRETRAINED_FOLDER)!r}).sample(picture, 30, seed=7).samples.shape)
"""
    assert run(python, "-c", code, folder=tmp_path).strip() == "(30, 2)"
