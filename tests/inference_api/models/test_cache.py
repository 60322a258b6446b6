"""The cache on disk: names stay names, processes share it, and what a dead one has left goes."""

import errno
import resource
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from cspace.bundle.files import read_files
from cspace.errors import RegistryError, StorageError
from inference_api.models.cache import LOCK_S, MAX_DESCRIPTION_BYTES, DiskCache
from inference_api.models.worker import DOWNLOAD_S
from services.registry.entities import ModelVersion

ROOT = Path(__file__).parents[3]
USER = Path(__file__).with_name("cache_user.py")
VERSION = ModelVersion("m", 1, "r", "a" * 64, ("champion",), {"a": "b"}, 5)


@pytest.fixture
def disk(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "cache", lock_s=0.2)


def written(version: ModelVersion, folder: Path) -> Path:
    folder.mkdir()
    (folder / "file").write_bytes(b"x" * 1000)
    return folder


def names(disk: DiskCache) -> set[str]:
    return {path.name for path in (disk.folder / "m").iterdir()}


def test_a_name_that_leads_elsewhere_is_never_a_folder(disk: DiskCache, tmp_path: Path) -> None:
    for name in ("../m", "..", "m/../../m", "/srv/m", ".m", "", "m\n"):
        version = replace(VERSION, name=name)
        for change in (
            partial(disk.download, download=written),
            disk.remove,
            disk.remember_champion,
            disk.bundle,
        ):
            with pytest.raises(StorageError, match="name"):
                change(version)
        assert disk.stored(name) == []
        assert disk.last_champion(name) is None
    assert list(tmp_path.iterdir()) == []


def test_a_description_of_another_model_is_not_believed(disk: DiskCache) -> None:
    disk.download(VERSION, written)
    disk.remember_champion(VERSION)
    for path in (disk.folder / "m").rglob("*.json"):
        path.write_text(path.read_text().replace('"m"', '"../m"'))
    assert (disk.stored("m"), disk.last_champion("m")) == ([], None)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"number":1', '"number":"1"'),
        ('"number":1', '"number":-1'),
        ('"name":"m"', '"name":"m","more":1'),
        ("{", "[" * 100_000),
        ("{", " " * MAX_DESCRIPTION_BYTES + "{"),
    ],
)
def test_a_description_of_other_types_or_without_end_is_none(disk: DiskCache, old: str, new: str) -> None:
    disk.download(VERSION, written)
    assert disk.stored("m") == [VERSION]
    (path,) = disk.folder.glob("m/*/version.json")
    text = path.read_text()
    path.write_text(text.replace(old, new, 1))
    assert path.read_text() != text
    assert disk.stored("m") == []


def test_what_a_dead_process_has_left_goes_with_the_next_change(disk: DiskCache) -> None:
    left = disk.folder / "m" / ".download-abc"
    left.mkdir(parents=True)
    (left / "half").write_text("a bun")
    disk.download(VERSION, written)
    assert names(disk) == {f"1-{'a' * 16}"}


def test_a_download_that_fails_leaves_nothing(disk: DiskCache) -> None:
    def fail(version: ModelVersion, folder: Path) -> Path:
        written(version, folder)
        raise RegistryError("gone")

    with pytest.raises(RegistryError):
        disk.download(VERSION, fail)
    assert names(disk) == set()


def test_a_folder_that_another_holds_is_waited_for_and_then_given_up(disk: DiskCache) -> None:
    holds, ended = threading.Event(), threading.Event()

    def slow(version: ModelVersion, folder: Path) -> Path:
        holds.set()
        ended.wait(10)
        return written(version, folder)

    other = threading.Thread(target=DiskCache(disk.folder).download, args=(VERSION, slow))
    other.start()
    holds.wait(10)
    began_s = time.monotonic()
    with pytest.raises(StorageError, match="in use"):
        disk.remove(VERSION)
    assert 0.2 <= time.monotonic() - began_s < 8.0
    # Another model's folder is free, and reading needs no lock.
    disk.download(replace(VERSION, name="n"), written)
    assert disk.stored("m") == []
    ended.set()
    other.join()
    disk.remove(VERSION)
    assert names(disk) == set()


def test_a_second_process_waits_for_the_first_ones_download_as_long_as_that_may_take(disk: DiskCache) -> None:
    holds, downloads = threading.Event(), []

    def slow(version: ModelVersion, folder: Path) -> Path:
        downloads.append(version)
        holds.set()
        # Longer than the fixture's patience, and a small part of the real one.
        threading.Event().wait(0.4)
        return written(version, folder)

    first = threading.Thread(target=DiskCache(disk.folder).download, args=(VERSION, slow))
    first.start()
    holds.wait(10)
    DiskCache(disk.folder).download(VERSION, slow)
    first.join()
    assert downloads == [VERSION]
    assert LOCK_S > DOWNLOAD_S


def test_a_full_disk_is_told_in_the_systems_words_without_a_path(disk: DiskCache) -> None:
    def full(version: ModelVersion, folder: Path) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device", str(folder))

    with pytest.raises(StorageError, match="CSPACE_MODEL_CACHE") as caught:
        disk.download(VERSION, full)
    assert caught.value.got == "No space left on device"
    assert str(disk.folder) not in str(caught.value)


def test_a_file_that_outgrows_the_processs_limit_is_a_storage_error(disk: DiskCache) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        with pytest.raises(StorageError) as caught:
            disk.download(VERSION, written)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.got == "File too large"
    assert names(disk) == set()


def user(cache: Path, bundle: Path, seed: int, rounds: int) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, str(USER), str(cache), str(bundle), str(seed), str(rounds)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"},
        text=True,
    )


@pytest.mark.slow
def test_processes_that_share_a_cache_never_fail_and_leave_nothing_behind(
    disk: DiskCache, bundles: dict[str, Path]
) -> None:
    victim = user(disk.folder, bundles["plain"], 0, 10_000)
    users = [user(disk.folder, bundles["plain"], seed, 50) for seed in (1, 2, 3)]
    assert victim.stdout is not None
    assert victim.stdout.readline() == "ready\n"
    threading.Event().wait(1.0)
    victim.kill()
    victim.communicate()
    for one in users:
        out, errors = one.communicate(timeout=100)
        assert (one.returncode, out) == (0, "ready\n"), errors
    version = ModelVersion("m", 9, "", read_files(bundles["plain"]).digest, (), {}, 0)
    disk.download(version, lambda _, folder: Path(shutil.copytree(bundles["plain"], folder)))
    disk.remove(version)
    left = [name for name in names(disk) if name.startswith(".")]
    # At most what the killed one was writing when it died, which is as long as a line.
    assert [name for name in left if not name.startswith(".write-")] == []
    assert len(left) <= 1
    for place in (disk.folder / "m").glob("[0-9]*"):
        read_files(place / "bundle")
