import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.local.processes import Record, start_detached, stop
from services.local.settings import Settings

SLEEPER = "import time; print('up', flush=True); time.sleep(300)"
StartPython = Callable[..., Record]


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    made = Settings(home=tmp_path / "state", root=tmp_path / "checkout")
    made.root.mkdir()
    made.make_folders()
    return made


@pytest.fixture
def start_python(tmp_path: Path) -> Iterator[StartPython]:
    """Start real child processes from a program text; they are ended after the test."""
    records: list[Record] = []

    def start(program: str = SLEEPER, service: str = "sleeper") -> Record:
        record = start_detached(
            service,
            [sys.executable, "-c", program],
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
