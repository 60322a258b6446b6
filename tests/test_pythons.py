"""Which Python `make` takes, and which versions the project says it supports."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAKE = shutil.which("make") or "make"
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def make(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run this Makefile in an empty folder, where there is no environment yet."""
    return subprocess.run(
        [MAKE, "--silent", "--file", str(ROOT / "Makefile"), *arguments],
        cwd=folder,
        env={"PATH": os.environ["PATH"], **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )


def command(folder: Path, name: str, script: str) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def chosen(folder: Path, *names: str) -> str:
    """What `make` takes where these commands start this Python, and the others are there but broken."""
    for name in ("python3.11", "python3", "python3.12", "python3.13"):
        command(folder / "bin", name, f'exec "{sys.executable}" "$@"' if name in names else "exit 127")
    show = "show: ; @echo $(PYTHON)"
    return make(folder, "--eval", show, "show", PATH=f"{folder}/bin:/bin").stdout.strip()


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        (("python3", "python3.11", "python3.13"), "python3.11"),
        # A shim that starts nothing, as pyenv's of a version that is not chosen, is not taken.
        (("python3", "python3.12"), "python3"),
        (("python3.13",), "python3.13"),
        ((), ""),
    ],
)
def test_make_takes_the_first_supported_python_that_runs(
    tmp_path: Path, names: tuple[str, ...], taken: str
) -> None:
    assert chosen(tmp_path, *names) == taken


def test_a_python_that_is_not_supported_is_refused_with_the_remedy(tmp_path: Path) -> None:
    old = command(tmp_path / "bin", "python3.10", "exit 1")
    refused = make(tmp_path, "interpreter", f"PYTHON={old}")
    assert refused.returncode == 2
    assert f"Python 3.11, 3.12 or 3.13 is needed and '{old}' is none of them" in refused.stderr
    assert "make PYTHON=" in refused.stderr


def test_an_environment_of_another_python_than_the_one_asked_for_is_not_used(tmp_path: Path) -> None:
    (tmp_path / ".venv").mkdir()
    command(tmp_path / ".venv" / "bin", "python", 'test "$1" != --version || echo Python 3.12.99')
    refused = make(tmp_path, "interpreter", f"PYTHON={sys.executable}")
    assert refused.returncode == 2
    assert ".venv was made with Python 3.12.99 and PYTHON names another" in refused.stderr
    # Without PYTHON it is used, and no other Python needs to be there.
    assert make(tmp_path, "interpreter", PATH="/nowhere:/bin").returncode == 0


def test_the_supported_versions_are_the_same_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    client = tomllib.loads((ROOT / "clients/python/pyproject.toml").read_text(encoding="utf-8"))["project"]
    versions = re.search(r"for version in ([\d. ]+);", MAKEFILE)
    assert versions
    supported = versions[1].split()
    for described in (project, client):
        listed = [re.fullmatch(r".*Python :: (3\.\d+)", one) for one in described["classifiers"]]
        assert [one[1] for one in listed if one] == supported
    assert project["requires-python"] == f">={supported[0]},<3.{int(supported[-1].partition('.')[2]) + 1}"


def test_a_pin_is_exact_and_stands_once() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[\w.]+", pin) for pin in pins)
    assert pins == sorted(set(pins))
    names = [pin.partition("==")[0] for pin in pins]
    assert len(names) == len(set(names))
