"""Processes of a pool end with the process that made them, in whatever way that ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PARENT = """
import os, sys, time
from services.evaluator.processes import ProcessMapper

if __name__ == "__main__":
    with ProcessMapper(2) as mapper:
        for child in set(mapper({waits}, range(8))):
            print(child, flush=True)
        print("ready", flush=True)
        time.sleep(60)
"""


def is_there(pid: int) -> bool:
    """Whether a process runs; one that ended and is not yet fetched does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def pid_of(_: object) -> int:
    """The process that it is asked in."""
    time.sleep(0.05)
    return os.getpid()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_is_left_of_a_pool_whose_parent_was_ended(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "parent.py"
    told = "from tests.services.evaluator.test_processes import pid_of\n"
    script.write_text(told + PARENT.format(waits="pid_of"))
    root = str(Path(__file__).parents[3])
    environment = {**os.environ, "PYTHONPATH": root}
    with subprocess.Popen(
        [sys.executable, str(script)], cwd=root, env=environment, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        children = [int(line) for line in iter(parent.stdout.readline, "ready\n")]
        assert children
        assert all(is_there(child) for child in children)
        parent.send_signal(how)
    ends_by = time.monotonic() + 20
    while any(map(is_there, children)) and time.monotonic() < ends_by:
        time.sleep(0.05)
    assert not any(map(is_there, children))
