"""A child that is late, dies, or eats memory is ended, and the next call has another process."""

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
from cspace.errors import BundleError, BundleIntegrityError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import LoaderApart, NotVerifiedError
from inference_api.models.apart.processes.child import Child, ChildLimits
from inference_api.models.apart.processes.pipes import ChildError
from inference_api.models.version_files import to_values
from services.registry.models.port import ModelVersion
from tests.inference_api.bad_bundles import write_hungry_bundle, write_looping_bundle

VERIFY_S = 2.0
ROOT = Path(__file__).parents[5]
Place = Callable[[Path], ModelVersion]


@pytest.fixture
def disk(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "cache")


@pytest.fixture
def place(disk: DiskCache) -> Place:
    """Puts a bundle into the cache as the next version."""
    numbers = iter(range(1, 100))

    def put(bundle: Path) -> ModelVersion:
        version = ModelVersion("m", next(numbers), "", read_files(bundle).digest, (), {}, 0)
        disk.download(version, lambda _, folder: Path(shutil.copytree(bundle, folder)))
        return version

    return put


def loading(disk: DiskCache, limits: ChildLimits | None = None) -> Child:
    configuration = {
        "registry_uri": None,
        "cache_folder": str(disk.folder),
        "stored": 20,
        "lock_s": 1.0,
        "downloads": False,
    }
    return Child("loading", configuration, limits)


@pytest.fixture
def child(disk: DiskCache) -> Iterator[Child]:
    child = loading(disk)
    yield child
    child.close()


@pytest.fixture
def loader(child: Child) -> LoaderApart:
    return LoaderApart(child, verify_s=VERIFY_S)


def wait_until(condition: Callable[[], bool], within_s: float = 10.0) -> None:
    pause = threading.Event()
    until_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until_s, "waited in vain"
        pause.wait(0.02)


def test_sound_bundles_are_verified_by_one_process(
    child: Child, loader: LoaderApart, place: Place, bundles: dict[str, Path]
) -> None:
    pids = set()
    for name in ("plain", "other"):
        loader.verify(place(bundles[name]))
        pids.add(child.pid)
    (pid,) = pids
    assert pid != os.getpid()


def test_a_bundle_that_is_not_the_registered_one_is_told_by_its_own_error(
    loader: LoaderApart, disk: DiskCache, place: Place, bundles: dict[str, Path]
) -> None:
    version = place(bundles["plain"])
    (disk.bundle(version) / "encoder.onnx").write_bytes(b"torn")
    with pytest.raises(BundleIntegrityError, match=r"encoder\.onnx: changed"):
        loader.verify(version)


def test_a_graph_that_loops_for_ever_is_refused_in_time_and_its_process_is_gone(
    child: Child, loader: LoaderApart, place: Place, tmp_path: Path, bundles: dict[str, Path]
) -> None:
    loader.verify(place(bundles["plain"]))
    pid = child.pid
    assert pid is not None
    looping = place(write_looping_bundle(tmp_path / "looping"))
    began_s = time.monotonic()
    with pytest.raises(BundleError, match="takes too long"):
        loader.verify(looping)
    assert VERIFY_S <= time.monotonic() - began_s < VERIFY_S + 10.0
    assert (child.pid, psutil.pid_exists(pid)) == (None, False)
    loader.verify(place(bundles["other"]))


def test_a_graph_that_eats_memory_is_refused_and_takes_none_of_this_process(
    loader: LoaderApart, place: Place, tmp_path: Path, bundles: dict[str, Path]
) -> None:
    hungry = place(write_hungry_bundle(tmp_path / "hungry"))
    before = psutil.Process().memory_info().rss
    with pytest.raises(BundleError):
        loader.verify(hungry)
    assert psutil.Process().memory_info().rss - before < 20 * 2**20
    loader.verify(place(bundles["plain"]))


def test_a_process_that_is_killed_at_work_is_followed_by_another(
    child: Child, loader: LoaderApart, place: Place, tmp_path: Path, bundles: dict[str, Path]
) -> None:
    loader.verify(place(bundles["plain"]))
    looping = place(write_looping_bundle(tmp_path / "looping"))
    pid = child.pid
    assert pid is not None
    threading.Timer(0.3, os.kill, (pid, signal.SIGKILL)).start()
    with pytest.raises(BundleError, match="has ended"):
        loader.verify(looping)
    loader.verify(place(bundles["other"]))
    assert child.pid not in (None, pid)


def test_a_child_that_is_closed_ends_the_call_that_waits_for_it(
    child: Child, loader: LoaderApart, place: Place, tmp_path: Path
) -> None:
    looping = place(write_looping_bundle(tmp_path / "looping"))
    child.start()
    threading.Timer(1.0, child.close).start()
    began_s = time.monotonic()
    with pytest.raises((BundleError, NotVerifiedError)):
        LoaderApart(child, verify_s=60.0).verify(looping)
    assert time.monotonic() - began_s < 30.0
    assert child.pid is None
    with pytest.raises(ChildError, match="shutting down"):
        child.call("verify", {"version": to_values(looping)}, 1.0)


def test_a_child_without_work_leaves_by_itself_and_comes_back(
    disk: DiskCache, place: Place, bundles: dict[str, Path]
) -> None:
    child = loading(disk, ChildLimits(idle_s=0.1))
    try:
        version = place(bundles["plain"])
        LoaderApart(child).verify(version)
        pid = child.pid
        assert pid is not None

        def is_cleared() -> bool:
            child.tend()
            return child.pid is None

        wait_until(is_cleared)
        assert not psutil.pid_exists(pid)
        LoaderApart(child).verify(version)
    finally:
        child.close()


ORPHAN = """
import os, sys, threading
from pathlib import Path
from inference_api.models.apart.processes.child import Child
from inference_api.models.version_files import read_version, to_values
(file,) = Path(sys.argv[1]).glob("m/*/version.json")
child = Child("loading", {"registry_uri": None, "cache_folder": sys.argv[1], "stored": 1, "lock_s": 1.0,
                          "downloads": False})
ended = threading.Timer(2.0, os._exit, (7,))
ended.start()
child.start()
print(child.pid, flush=True)
child.call("verify", {"version": to_values(read_version(file))}, 600.0)
"""


def test_a_child_in_the_middle_of_a_loop_ends_when_its_parent_dies(
    disk: DiskCache, place: Place, tmp_path: Path
) -> None:
    place(write_looping_bundle(tmp_path / "looping"))
    done = subprocess.run(
        [sys.executable, "-c", ORPHAN, str(disk.folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 7, done.stderr
    pid = int(done.stdout)
    wait_until(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)


def test_a_child_is_held_by_the_kernel_and_knows_no_setting_of_the_api(
    child: Child,
    loader: LoaderApart,
    place: Place,
    bundles: dict[str, Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("CSPACE_API_KEYS_FILE", "/somewhere")
    loader.verify(place(bundles["plain"]))
    process = psutil.Process(child.pid)
    soft, hard = process.rlimit(psutil.RLIMIT_AS)
    assert soft == hard < process.memory_info().vms + 2.5 * 2**30
    assert process.rlimit(psutil.RLIMIT_CORE) == (0, 0)
    assert process.rlimit(psutil.RLIMIT_FSIZE)[1] <= 2**30
    assert "CSPACE_API_KEYS_FILE" not in process.environ()
    assert os.getpgid(process.pid) == process.pid
    # The kernel shares cores out among sessions: one of its own could be left without any.
    assert os.getsid(process.pid) == os.getsid(0)
