"""Downloaded bundles on disk, for the next start and for when the registry is away; shared by processes.

A version lies at ``<cache>/<name>/<number>-<digest>/`` with its bundle and ``version.json``. The digest is
part of the name because a registry that was set up anew counts its versions from 1 again. Who changes a
model's folder holds its lock; who reads does not, and takes a version that vanishes as one that is not there.
"""

import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cspace.errors import BundleIntegrityError, StorageBusyError, StorageError
from cspace.files import HALF_PREFIX, holding
from inference_api.models.version_files import read_version, write_version
from services.registry.models.port import ModelVersion
from services.registry.references import is_model_name

_BUNDLE = "bundle"
_VERSION = "version.json"
_CHAMPION = "champion.json"
_TEMPORARY = ".download-"
_DIGEST = re.compile(r"[0-9a-f]{64}")
# Written in no time; one that is older is of a process that died.
_WRITTEN_S = 600.0
Download = Callable[[ModelVersion, Path], Path]


class DiskCache:
    """Versions on disk; safe to share between threads and processes.

    Args:
        folder: the cache; made when first needed.
        stored: versions of each model that are kept beside its last champion, at least 1.
        lock_s: how long another process may hold a model's folder.
    """

    def __init__(self, folder: Path, stored: int = 20, lock_s: float = 60.0) -> None:
        self.folder, self.kept, self.lock_s = folder, stored, lock_s

    def bundle(self, version: ModelVersion) -> Path:
        """Where a version's bundle is, or would be.

        Raises:
            BundleIntegrityError: the version has no digest.
            StorageError: its name is none that may become a folder's.
        """
        return self._place(version) / _BUNDLE

    def holds(self, version: ModelVersion) -> bool:
        """Whether a version is there."""
        return self.bundle(version).is_dir()

    def download(self, version: ModelVersion, download: Download) -> None:
        """Put a version there that is not; the least recently used beyond those that are kept go.

        Args:
            version: which.
            download: the registry's.

        Raises:
            RegistryError: it cannot be downloaded.
            StorageBusyError: another process changes the model for too long.
            StorageError: the cache cannot be written.
        """
        place = self._place(version)
        with self._changing(version.name):
            if place.exists():
                return
            with tempfile.TemporaryDirectory(prefix=_TEMPORARY, dir=place.parent) as temporary:
                whole = Path(temporary) / "whole"
                whole.mkdir()
                download(version, Path(temporary) / "download").rename(whole / _BUNDLE)
                write_version(whole / _VERSION, version)
                whole.rename(place)
            self._prune(version.name, place)

    def remove(self, version: ModelVersion) -> None:
        """Take a version away.

        Raises:
            StorageError: the cache cannot be written.
        """
        with self._changing(version.name):
            _delete(self._place(version))

    def touch(self, version: ModelVersion) -> None:
        """Note that a version was used; a cache that is read only keeps the old time."""
        # Not by the file system's own clock, whose ticks are as long as several uses.
        now_ns = time.time_ns()
        with suppress(OSError):
            os.utime(self._place(version) / _VERSION, ns=(now_ns, now_ns))

    def stored(self, name: str) -> list[ModelVersion]:
        """Versions of a model that are on disk, oldest first."""
        if not is_model_name(name):
            return []
        found = [read_version(path) for path in self.folder.glob(f"{name}/*/{_VERSION}")]
        mine = [version for version in found if version and version.name == name]
        return sorted(mine, key=lambda version: version.created_ms)

    def last_champion(self, name: str) -> ModelVersion | None:
        """The champion of a model when the registry was last there."""
        if not is_model_name(name):
            return None
        found = read_version(self.folder / name / _CHAMPION)
        return found if found and found.name == name else None

    def remember_champion(self, version: ModelVersion) -> None:
        """Keep a version as the last known champion of its model.

        Raises:
            StorageError: the cache cannot be written.
        """
        place = self._place(version).with_name(_CHAMPION)
        try:
            write_version(place, version)
        except OSError as error:
            raise _not_writable(error) from None

    @contextmanager
    def _changing(self, name: str) -> Iterator[None]:
        _check_name(name)
        folder = self.folder / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            busy = StorageBusyError(
                "the model cache is in use",
                expected="one process at a time to change a model's versions",
                got="another one that takes long",
                remedy="ask again, or give each server a CSPACE_MODEL_CACHE of its own",
            )
            with holding(self.folder / f".{name}.lock", busy, self.lock_s, look_every_s=0.02):
                _clear_left_overs(folder)
                yield
        except OSError as error:
            raise _not_writable(error) from None

    def _prune(self, name: str, newest: Path) -> None:
        champion = self.last_champion(name)
        safe = {newest} if champion is None else {newest, self._place(champion)}
        with suppress(OSError):
            found = sorted(
                self.folder.glob(f"{name}/*/{_VERSION}"),
                key=lambda path: path.stat().st_mtime_ns,
                reverse=True,
            )
            for path in found[self.kept :]:
                if path.parent not in safe:
                    _delete(path.parent)

    def _place(self, version: ModelVersion) -> Path:
        _check_name(version.name)
        if _DIGEST.fullmatch(version.digest) is None:
            raise BundleIntegrityError(
                f"{version} was registered without a digest",
                expected="64 hexadecimal digits",
                got=repr(version.digest)[:100],
                remedy="register the bundle again",
            )
        return self.folder / version.name / f"{version.number}-{version.digest[:16]}"


def _delete(place: Path) -> None:
    """By a rename first: what is read is there whole or not at all, and a death in the middle is cleared."""
    if place.exists():
        gone = Path(tempfile.mkdtemp(prefix=_TEMPORARY, dir=place.parent))
        place.rename(gone / place.name)
        shutil.rmtree(gone, ignore_errors=True)


def _clear_left_overs(folder: Path) -> None:
    """Of processes that died: by whoever holds the lock, so nobody works in a temporary folder."""
    for path in folder.glob(f"{_TEMPORARY}*"):
        shutil.rmtree(path, ignore_errors=True)
    for path in folder.glob(f"{HALF_PREFIX}*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _WRITTEN_S:
                path.unlink()


def _check_name(name: str) -> None:
    if not is_model_name(name):
        raise StorageError(
            "a model's name cannot be a folder's of the cache",
            expected="letters, digits, dot, underscore and hyphen, the first a letter or a digit",
            got=repr(name)[:100],
        )


def _not_writable(error: OSError) -> StorageError:
    return StorageError(
        "the model cache cannot be written",
        expected="room and rights in CSPACE_MODEL_CACHE",
        got=error.strerror or type(error).__name__,
        remedy="free some space, or set CSPACE_MODEL_CACHE to another folder",
    )
