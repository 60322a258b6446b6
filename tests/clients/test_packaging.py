"""What the distribution ``cspace-client`` is: small, typed, and what its documents say."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CLIENT = ROOT / "clients" / "python"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, for building leaves its traces in the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    source = shutil.copytree(
        CLIENT, folder / "source", ignore=shutil.ignore_patterns("*.egg-info", "build", "__pycache__")
    )
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(source)], check=True, capture_output=True)
    (found,) = folder.glob("*.whl")
    return found


def test_the_wheel_is_small_and_holds_the_package_alone(wheel: Path) -> None:
    assert wheel.stat().st_size < 100_000
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.partition("/")[0] for name in names}
    assert tops == {"cspace_client", "cspace_client-0.1.0.dist-info"}
    sources = {str(path.relative_to(CLIENT / "src")) for path in (CLIENT / "src").rglob("*.py")}
    assert {name for name in names if name.endswith(".py")} == sources
    assert "cspace_client/py.typed" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_it_needs_numpy_and_httpx_alone(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("METADATA"))
        told = Parser().parsestr(archive.read(name).decode())
    required = told.get_all("Requires-Dist")
    plain = [one for one in required if "extra ==" not in one]
    assert sorted(one.partition("<")[0].partition(">")[0] for one in plain) == ["httpx", "numpy"]
    assert told.get_all("Provides-Extra") == ["ompl", "local"]


def test_it_has_the_projects_version() -> None:
    main, client = (
        tomllib.loads((folder / "pyproject.toml").read_text())["project"] for folder in (ROOT, CLIENT)
    )
    assert client["version"] == main["version"]
    assert client["name"] in main["optional-dependencies"]["train"]


def test_an_image_installs_what_the_client_needs_and_copies_it() -> None:
    command = [sys.executable, "docker/requirements.py", "train"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout.split("\n")
    needed = tomllib.loads((CLIENT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert set(needed) <= set(printed)
    assert "cspace-client" not in printed
    lines = (ROOT / "docker" / "ray.Dockerfile").read_text().splitlines()
    assert "COPY clients/python/src/cspace_client /app/cspace_client" in lines
    assert "!clients" in (ROOT / ".dockerignore").read_text().splitlines()
