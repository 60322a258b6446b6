"""A bundle of others runs in a worker first, which is ended when it takes too long or too much."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from cspace import bounded
from cspace.bundle import Bundle, verification
from cspace.bundle.files import read_files
from cspace.bundle.runtime import container_bytes
from cspace.bundle.verification import load_verified, memory_bytes, verify
from cspace.errors import (
    BundleError,
    BundleIntegrityError,
    CspaceError,
    GoldenMismatchError,
    ServiceError,
)
from services.evaluator.benchmark.sources import bundled
from services.planner.samples import LocalSampler
from tests.cspace.test_bundle_integrity import golden_of, resign
from tests.inference_api.bad_bundles import write_hungry_bundle, write_slow_bundle
from training.paths.writing import source_bundle

ROOT = Path(__file__).parents[2]


def test_a_sound_bundle_is_opened_after_its_verification_in_a_worker_that_knows_no_password(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_PASSWORD", "secret")
    seen = dict[str, str]()
    real = subprocess.Popen

    def note(command: list[str], **options: object) -> subprocess.Popen[bytes]:
        seen.update(options["env"])  # type: ignore[call-overload]
        return real(command, **options)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(bounded.subprocess, "Popen", note)
    assert load_verified(folder).digest == read_files(folder).digest
    assert seen
    assert "secret" not in seen.values()


def test_errors_of_the_worker_are_those_of_loading(folder: Path) -> None:
    with pytest.raises(BundleIntegrityError, match="registered"):
        verify(folder, "0" * 64)
    case = golden_of(folder)
    moved = {name: getattr(case, name) for name in case.__slots__} | {"mu": case.mu + 1.0}
    (folder / "golden.npz").write_bytes(type(case)(**moved).to_npz())
    resign(folder)
    with pytest.raises(GoldenMismatchError, match="mu"):
        verify(folder)


def test_a_bundle_that_computes_for_minutes_is_refused_in_time(tmp_path: Path) -> None:
    slow = write_slow_bundle(tmp_path / "slow")
    began_s = time.monotonic()
    with pytest.raises(BundleError, match="no end within 1 s"):
        verify(slow, limit_s=1.0)
    assert time.monotonic() - began_s < 20.0


def test_a_bundle_that_takes_memory_takes_none_of_this_process(tmp_path: Path) -> None:
    hungry = write_hungry_bundle(tmp_path / "hungry")
    before = psutil.Process().memory_info().rss
    with pytest.raises(BundleError, match=r"MiB of memory|Available memory of"):
        verify(hungry)
    assert psutil.Process().memory_info().rss - before < 20 * 2**20


PARENT = """
import os, sys, threading
from pathlib import Path
from cspace.bundle.verification import verify
threading.Timer(2.0, os._exit, (7,)).start()
verify(Path(sys.argv[1]), limit_s=600.0)
"""


def test_a_worker_ends_with_its_parent(tmp_path: Path) -> None:
    slow = write_slow_bundle(tmp_path / "slow")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "clients/python/src")])}
    done = subprocess.run(
        [sys.executable, "-c", PARENT, str(slow)], cwd=tmp_path, env=environment, check=False
    )
    assert done.returncode == 7
    until_s = time.monotonic() + 10.0
    while any(process.info["cwd"] == str(tmp_path) for process in psutil.process_iter(["cwd"])):
        assert time.monotonic() < until_s, "the worker lives on"
        time.sleep(0.05)


def test_a_library_that_is_missing_is_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "onnx.py").write_text("raise ModuleNotFoundError(name='onnx')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ServiceError, match="no package onnx; pip install onnx"):
        verify(folder)


def test_a_worker_that_does_not_start_says_nothing_of_the_bundle(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(ServiceError, match="the bundle cannot be read"):
        verify(folder)


@pytest.mark.parametrize(
    "open_folder",
    [
        LocalSampler,
        lambda folder: bundled("mine", folder),
        lambda folder: source_bundle(str(folder), None, folder / "none"),  # type: ignore[arg-type] # not asked
    ],
    ids=["planner", "benchmark", "training"],
)
def test_a_folder_of_others_is_opened_by_its_path_after_the_worker_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch, open_folder: Callable[[Path], object]
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(CspaceError, match="the bundle cannot be read"):
        open_folder(folder)


def test_a_worker_takes_no_more_than_a_share_of_its_container(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verification, "container_bytes", lambda: 768 * 2**20)
    assert memory_bytes() == 192 * 2**20
    monkeypatch.setattr(verification, "container_bytes", lambda: None)
    assert memory_bytes() == 2**30


@pytest.mark.parametrize(
    ("group", "files", "limit"),
    [
        ("0::/", {"memory.max": "805306368\n"}, 805306368),
        ("0::/", {"memory.max": "max\n"}, None),
        ("0::/a/b", {"a/memory.max": "1000000\n", "a/b/memory.max": "max\n"}, 1000000),
        ("4:memory:/", {"memory/memory.limit_in_bytes": "2000000\n"}, 2000000),
        ("4:memory:/", {"memory/memory.limit_in_bytes": "9223372036854771712\n"}, None),
        ("", {}, None),
    ],
)
def test_the_limit_of_a_container_is_that_of_its_control_groups(
    tmp_path: Path, group: str, files: dict[str, str], limit: int | None
) -> None:
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(f"{group}\n")
    for name, text in files.items():
        file = tmp_path / "sys/fs/cgroup" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    assert container_bytes(tmp_path) == limit


def test_a_graph_that_was_not_checked_is_held_by_the_arena(tmp_path: Path) -> None:
    hungry = write_hungry_bundle(tmp_path / "hungry")
    before = psutil.Process().memory_info().rss
    with pytest.raises(BundleError, match=r"Available memory of"):
        Bundle.load(hungry, check=False, replay=True)
    assert psutil.Process().memory_info().rss - before < 600 * 2**20
