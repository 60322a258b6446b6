"""Bundles with something changed: loaded or refused. In a child process, for onnxruntime could end it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


def fuzzed(first: int, seconds: float, count: int) -> dict[str, int]:
    command = [sys.executable, "-m", "tests.cspace.bundle_fuzz", str(first), str(seconds), str(count)]
    root = Path(__file__).parents[2]
    done = subprocess.run(
        command, cwd=root, capture_output=True, text=True, timeout=seconds + 60.0, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, int] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.slow
def test_a_few_hundred_changed_bundles_load_or_are_refused() -> None:
    found = fuzzed(0, 60.0, 300)
    assert sum(found.values()) == 300
    # Neither is all of one kind, or the changes would try nothing.
    assert min(found["loaded"], found["refused"], found["refused by its allow-list"]) > 5


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_many_changed_bundles_load_or_are_refused() -> None:
    assert sum(fuzzed(1_000_000, 240.0, 30_000).values()) > 1000
