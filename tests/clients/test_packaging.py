"""What the distribution ``cspace-client`` is: small, typed, and what its documents say."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

ROOT = Path(__file__).parents[2]
CLIENT = ROOT / "clients" / "python"


def test_the_wheel_is_small_holds_the_package_alone_and_needs_little(tmp_path: Path) -> None:
    # From a copy, for building leaves its traces in the sources.
    source = shutil.copytree(
        CLIENT, tmp_path / "source", ignore=shutil.ignore_patterns("*.egg-info", "build")
    )
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(tmp_path), str(source)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.stat().st_size < 100_000
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith("METADATA"))
    assert {name.partition("/")[0] for name in names} == {"cspace_client", "cspace_client-0.1.0.dist-info"}
    assert {"cspace_client/ompl.py", "cspace_client/py.typed"} < set(names)
    plain = [one for one in Parser().parsestr(metadata).get_all("Requires-Dist") if "extra ==" not in one]
    assert sorted(one.partition("<")[0].partition(">")[0] for one in plain) == ["httpx", "numpy", "pydantic"]


def test_it_has_the_projects_version() -> None:
    main, client = (
        tomllib.loads((folder / "pyproject.toml").read_text())["project"] for folder in (ROOT, CLIENT)
    )
    assert client["version"] == main["version"]
    assert client["name"] in main["optional-dependencies"]["train"]
