"""A bundle of others runs in a worker first, which is ended when it takes too long or too much."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from cspace import bounded_worker
from cspace.bundle import Bundle
from cspace.bundle.files import read_files
from cspace.bundle.load import load_verified, verify
from cspace.errors import (
    BundleError,
    BundleIntegrityError,
    GoldenMismatchError,
)
from tests.cspace.test_bundle_integrity import golden_of, resign
from tests.inference_api.bad_bundles import write_hungry_bundle, write_slow_bundle

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

    monkeypatch.setattr(bounded_worker.subprocess, "Popen", note)
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
from cspace.bundle.load import verify
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


def test_a_graph_that_was_not_checked_is_held_by_the_arena(tmp_path: Path) -> None:
    hungry = write_hungry_bundle(tmp_path / "hungry")
    before = psutil.Process().memory_info().rss
    bundle = Bundle.load(hungry, check=False, replay=False)
    with pytest.raises(BundleError, match=r"Available memory of"):
        bundle.sample(np.zeros(bundle.spec.world.sensor.picture_shape, np.uint8), 65, 0)
    assert psutil.Process().memory_info().rss - before < 600 * 2**20
