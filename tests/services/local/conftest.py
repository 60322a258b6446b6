import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.local.processes import Record, free_ports, start_detached, stop
from services.local.settings import Settings

SLEEPER = "import time; print('up', flush=True); time.sleep(300)"
StartPython = Callable[..., Record]


def settings_in(folder: Path) -> Settings:
    """Settings with an empty state folder and a checkout of their own."""
    made = Settings(home=folder / "state", root=folder / "checkout")
    made.root.mkdir(parents=True)
    made.make_folders()
    return made


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return settings_in(tmp_path)


@pytest.fixture
def own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    """What the commands read of the environment: a state folder and ports that nobody else uses."""
    for name, port in zip(("API", "RAY", "MLFLOW", "VIEWER"), free_ports(4), strict=True):
        monkeypatch.setenv(f"CSPACE_{name}_PORT", str(port))
    monkeypatch.setenv("CSPACE_HOME", str(tmp_path / "state"))
    # main() excepts loopback from proxies for its process; the test's own environment gets it back.
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.setenv(name, "")
    return Settings.from_environment()


@pytest.fixture
def start_python(tmp_path: Path) -> Iterator[StartPython]:
    """Start real child processes from a program text; they are ended after the test."""
    records: list[Record] = []

    def start(program: str = SLEEPER, service: str = "sleeper") -> Record:
        record = start_detached(
            service,
            [sys.executable, "-S", "-c", program],
            environment=os.environ,
            folder=tmp_path,
            log=tmp_path / f"{service}.log",
            root=tmp_path,
            address="http://127.0.0.1:1",
        )
        records.append(record)
        return record

    yield start
    for record in records:
        stop(record, grace_s=0.1)
