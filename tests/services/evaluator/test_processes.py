"""Processes of a pool end with the process that made them, even if that is killed."""

import os
import select
import subprocess
import sys
from pathlib import Path

import pytest

ENDED_WITHIN_S = 20.0

PARENT = """
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from services.evaluator.benchmark.job import end_with_parent
from tests.services.evaluator.test_processes import pid_of

if __name__ == "__main__":
    with ProcessPoolExecutor(1, get_context("spawn"), end_with_parent) as pool:
        print(*pool.map(pid_of, range(1)), flush=True)
        print("ready", flush=True)
        sys.stdin.read()
"""


def pid_of(_: object) -> int:
    """The process that it is asked in."""
    return os.getpid()


@pytest.mark.slow
def test_nothing_is_left_of_a_pool_whose_parent_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    root = str(Path(__file__).parents[3])
    environment = {**os.environ, "PYTHONPATH": root}
    with subprocess.Popen(
        [sys.executable, str(script)],
        cwd=root,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        children = [int(line) for line in iter(parent.stdout.readline, "ready\n")]
        assert children
        # A handle tells of the end of a process that is nobody's child here.
        handles = [os.pidfd_open(child) for child in children]
        parent.kill()
    try:
        for handle in handles:
            ended, _, _ = select.select([handle], [], [], ENDED_WITHIN_S)
            assert ended
    finally:
        for handle in handles:
            os.close(handle)
