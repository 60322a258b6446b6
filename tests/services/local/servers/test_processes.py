import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from cspace.errors import ServiceStartError
from services.local.processes import (
    MARKER,
    Record,
    family,
    find,
    is_alive,
    start_detached,
    stop,
    with_children,
)

StartPython = Callable[..., Record]
FOREVER = "import time; time.sleep(300)"

PARENT = f"""
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-Sc", {FOREVER!r}], start_new_session=True)
print(child.pid, flush=True)
time.sleep(300)
"""
CHILD = f"""
import os, subprocess, sys, time
grandchild = subprocess.Popen([sys.executable, "-Sc", {FOREVER!r}], env={{}})
print(os.getpid(), grandchild.pid, flush=True)
time.sleep(300)
"""
GRANDPARENT = f"""
import subprocess, sys, time
subprocess.Popen([sys.executable, "-Sc", {CHILD!r}])
time.sleep(300)
"""
DEAF = """
import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("up", flush=True)
time.sleep(300)
"""


def first_line(record: Record) -> str:
    """Wait for the first line of a process's log."""
    until = time.monotonic() + 20
    while time.monotonic() < until:
        lines = Path(record.log).read_text(encoding="utf-8").splitlines()
        if lines:
            return lines[0]
        time.sleep(0.01)
    raise AssertionError("the process wrote nothing")


def kill_and_reap(pid: int) -> None:
    process = psutil.Process(pid)
    process.kill()
    process.wait(timeout=10)


def test_a_started_process_is_known_runs_in_a_session_of_its_own_and_is_gone_when_stopped(
    start_python: StartPython,
) -> None:
    record = start_python()
    first_line(record)
    process = find(record)
    assert process is not None
    assert process.create_time() == pytest.approx(record.create_time)
    assert is_alive(record)
    assert os.getsid(record.pid) == record.pid != os.getsid(0)
    assert process.environ()[MARKER] == record.marker
    assert stop(record, grace_s=10) == 1
    assert not psutil.pid_exists(record.pid)
    assert stop(record, grace_s=10) == 0


def test_output_and_errors_are_appended_to_the_log(start_python: StartPython) -> None:
    program = "import sys; print('one'); sys.stdout.flush(); print('two', file=sys.stderr)"
    for _ in range(2):
        psutil.Process(start_python(program).pid).wait(timeout=20)
    log = Path(start_python().log).read_text(encoding="utf-8")
    assert log.startswith("one\ntwo\none\ntwo\n")


@pytest.mark.parametrize("orphaned", [False, True])
def test_children_in_other_sessions_end_with_their_parent_and_after_it(
    start_python: StartPython, orphaned: bool
) -> None:
    record = start_python(PARENT)
    child = int(first_line(record))
    assert [process.pid for process in family(record)] == [child]
    if orphaned:
        kill_and_reap(record.pid)
        assert not is_alive(record)
        assert is_running(child)
    assert stop(record, grace_s=10) == (1 if orphaned else 2)
    assert not is_running(child)


def test_a_recorded_child_is_ended_even_if_it_lost_its_marker_and_its_parent(
    start_python: StartPython,
) -> None:
    record = start_python(PARENT.replace("subprocess.Popen(", "subprocess.Popen(env={}, args="))
    child = int(first_line(record))
    recorded = with_children(record)
    assert [one.pid for one in recorded.children] == [child]
    kill_and_reap(record.pid)
    assert family(record) == []
    assert stop(recorded, grace_s=10) == 1
    assert not is_running(child)


def test_what_a_marked_orphan_has_started_without_a_marker_ends_with_it(start_python: StartPython) -> None:
    record = start_python(GRANDPARENT)
    pids = [int(pid) for pid in first_line(record).split()]
    kill_and_reap(record.pid)
    assert stop(record, grace_s=10) == 2
    assert not any(map(is_running, pids))


def test_a_process_that_ignores_the_request_to_end_is_killed(start_python: StartPython) -> None:
    record = start_python(DEAF)
    first_line(record)
    stop(record, grace_s=0.2)
    assert not psutil.pid_exists(record.pid)


def test_a_stranger_with_a_recorded_id_is_not_touched(start_python: StartPython) -> None:
    stranger = start_python(service="stranger")
    # The recorded process came to be ten seconds earlier; its id belongs to somebody else now.
    old = replace(stranger, create_time=stranger.create_time - 10, marker="sleeper-of-the-past")
    assert not is_alive(old)
    assert family(old) == []
    assert stop(old, grace_s=0.1) == 0
    assert is_alive(stranger)


def test_a_process_that_ended_but_was_not_reaped_is_not_alive(start_python: StartPython) -> None:
    record = start_python()
    os.kill(record.pid, signal.SIGKILL)
    os.waitid(os.P_PID, record.pid, os.WEXITED | os.WNOWAIT)
    assert psutil.Process(record.pid).status() == psutil.STATUS_ZOMBIE
    assert not is_alive(record)


def test_a_program_that_is_not_there_is_a_start_error(tmp_path: Path) -> None:
    with pytest.raises(ServiceStartError, match="nowhere"):
        start_detached(
            "nothing",
            [str(tmp_path / "nowhere")],
            environment={},
            folder=tmp_path,
            log=tmp_path / "log",
            root=tmp_path,
            address="",
        )


def is_running(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
