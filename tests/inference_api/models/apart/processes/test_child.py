"""A child that is late or dies is ended, and the next call has another process."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from cspace.bundle.files import read_files
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.processes.child import Child, ChildLimits
from inference_api.models.apart.processes.pipes import ChildError
from inference_api.models.version_files import to_values
from services.registry.models.port import ModelVersion
from tests.inference_api.trickling import trickling

ROOT = Path(__file__).parents[5]
ABSENT = {"version": to_values(ModelVersion("m", 99, "", "a" * 64, (), {}, 0))}


@pytest.fixture
def disk(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "cache")


@pytest.fixture
def silent() -> Iterator[str]:
    """A registry that never answers."""
    with trickling("silent") as place:
        yield f"http://{place}"


@pytest.fixture
def present(disk: DiskCache, bundles: dict[str, Path]) -> dict[str, object]:
    """The arguments of a job that is done at once: a version that is in the cache."""
    version = ModelVersion("m", 1, "", read_files(bundles["plain"]).digest, (), {}, 0)
    disk.download(version, lambda _, folder: Path(shutil.copytree(bundles["plain"], folder)))
    return {"version": to_values(version)}


def loading(disk: DiskCache, uri: str, limits: ChildLimits | None = None) -> Child:
    configuration = {"registry_uri": uri, "cache_folder": str(disk.folder), "stored": 20, "lock_s": 1.0}
    return Child("loading", configuration, limits)


@pytest.fixture
def child(disk: DiskCache, silent: str) -> Iterator[Child]:
    child = loading(disk, silent)
    yield child
    child.close()


def wait_until(condition: Callable[[], bool], within_s: float = 10.0) -> None:
    pause = threading.Event()
    until_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until_s, "waited in vain"
        pause.wait(0.02)


def test_a_job_that_takes_too_long_is_given_up_and_its_process_is_gone(
    child: Child, present: dict[str, object]
) -> None:
    child.call("download", present, 30.0)
    pid = child.pid
    assert pid not in (None, os.getpid())
    began_s = time.monotonic()
    with pytest.raises(ChildError, match="takes too long"):
        child.call("download", ABSENT, 0.5)
    assert time.monotonic() - began_s < 10.0
    assert (child.pid, psutil.pid_exists(pid or 0)) == (None, False)
    child.call("download", present, 30.0)
    assert child.pid not in (None, pid)


@pytest.mark.slow
def test_a_process_that_is_killed_at_work_is_followed_by_another(
    child: Child, present: dict[str, object]
) -> None:
    child.call("download", present, 30.0)
    pid = child.pid
    assert pid is not None
    threading.Timer(0.3, os.kill, (pid, signal.SIGKILL)).start()
    with pytest.raises(ChildError, match="has ended"):
        child.call("download", ABSENT, 30.0)
    child.call("download", present, 30.0)
    assert child.pid not in (None, pid)


@pytest.mark.slow
def test_a_child_that_is_closed_ends_the_call_that_waits_for_it(child: Child) -> None:
    child.start()
    threading.Timer(1.0, child.close).start()
    began_s = time.monotonic()
    with pytest.raises(ChildError):
        child.call("download", ABSENT, 60.0)
    assert time.monotonic() - began_s < 30.0
    assert child.pid is None
    with pytest.raises(ChildError, match="shutting down"):
        child.call("download", ABSENT, 1.0)


@pytest.mark.slow
def test_a_child_without_work_leaves_by_itself_and_comes_back(
    disk: DiskCache, silent: str, present: dict[str, object]
) -> None:
    child = loading(disk, silent, ChildLimits(idle_s=0.1))
    try:
        child.call("download", present, 30.0)
        pid = child.pid
        assert pid is not None

        def is_cleared() -> bool:
            child.tend()
            return child.pid is None

        wait_until(is_cleared)
        assert not psutil.pid_exists(pid)
        child.call("download", present, 30.0)
    finally:
        child.close()


ORPHAN = """
import os, sys, threading
from inference_api.models.apart.processes.child import Child
from tests.inference_api.models.apart.processes.test_child import ABSENT
configuration = {"registry_uri": sys.argv[2], "cache_folder": sys.argv[1], "stored": 1, "lock_s": 1.0}
child = Child("loading", configuration)
child.start()
print(child.pid, flush=True)
threading.Timer(2.0, os._exit, (7,)).start()
child.call("download", ABSENT, 600.0)
"""


@pytest.mark.slow
def test_a_child_in_the_middle_of_its_job_ends_when_its_parent_dies(disk: DiskCache, silent: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ORPHAN, str(disk.folder), silent],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 7, done.stderr
    pid = int(done.stdout)
    wait_until(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)


def test_a_child_is_held_by_the_kernel_and_knows_no_setting_of_the_api_but_the_store(
    child: Child, present: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CSPACE_API_KEYS_FILE", "/somewhere")
    monkeypatch.setenv("CSPACE_ARTIFACT_STORE", "s3://models")
    child.call("download", present, 30.0)
    process = psutil.Process(child.pid)
    soft, hard = process.rlimit(psutil.RLIMIT_AS)
    assert soft == hard < process.memory_info().vms + 2**30
    assert process.rlimit(psutil.RLIMIT_CORE) == (0, 0)
    assert process.rlimit(psutil.RLIMIT_FSIZE)[1] <= 2**30
    assert "CSPACE_API_KEYS_FILE" not in process.environ()
    assert process.environ()["CSPACE_ARTIFACT_STORE"] == "s3://models"
    assert os.getpgid(process.pid) == process.pid
    # The kernel shares cores out among sessions: one of its own could be left without any.
    assert os.getsid(process.pid) == os.getsid(0)
