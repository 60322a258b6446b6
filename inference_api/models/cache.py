"""Downloaded bundles: on disk, for the next start and for when the registry is away, and open in memory.

A version lies at ``<cache>/<name>/<number>-<digest>/`` with its bundle and ``version.json``. The digest is
part of the name because a registry that was set up again counts its versions from 1. Processes share the
cache: who changes a model's folder holds its lock; who reads does not, and takes a version that vanishes as
one that is not there.
"""

import os
import re
import shutil
import tempfile
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, MutableMapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock, Thread

from cachetools import LRUCache
from pydantic import TypeAdapter, ValidationError

from cspace.bundle import Bundle
from cspace.errors import (
    BundleError,
    BundleIntegrityError,
    CspaceError,
    RegistryError,
    RegistryUnavailableError,
    ServiceError,
    StorageBusyError,
    StorageError,
)
from cspace.files import HALF_PREFIX, holding, read_bounded, replacing
from inference_api.models.worker import DOWNLOAD_S
from inference_api.problem_types import ModelNotReadyError
from services.registry.entities import ModelReader, ModelVersion, is_model_name
from services.registry.signing import require_signature

# Longer than any description; what is longer is somebody else's file.
MAX_DESCRIPTION_BYTES = 2**20
# As long as another process may take for its download, and what comes after it.
LOCK_S = DOWNLOAD_S + 5.0
# A refused bundle is tried again less and less often: equal sums are equal bytes, and each verification may
# take a core for half a minute. What failed for another reason may be over soon.
RETRY_S, LONGEST_RETRY_S, SOON_S = 15.0, 900.0, 2.0
# Versions that may be on their way at a time.
MAX_PENDING = 16
_REMEMBERED = 1024
# A version may vanish between two steps, while other processes prune the cache.
_ATTEMPTS = 5
_BUNDLE, _VERSION, _CHAMPION = "bundle", "version.json", "champion.json"
_TEMPORARY = ".download-"
# A file is written in no time; one that is older belongs to a process that died.
_WRITTEN_S = 600.0
_DESCRIPTION = TypeAdapter(ModelVersion)
Key = tuple[str, int, str]


class NotVerifiedError(RegistryUnavailableError):
    """Nobody could look at the bundle, which says nothing about it."""


def key_of(version: ModelVersion) -> Key:
    """What tells versions apart, also those of a registry that was set up again."""
    return version.name, version.number, version.digest


class DiskCache:
    """Versions on disk; safe to share between threads and processes.

    Args:
        folder: the cache; made when first needed.
        stored: versions of each model that are kept beside its last champion, at least 1.
        lock_s: how long another process may hold a model's folder.
    """

    def __init__(self, folder: Path, stored: int = 20, lock_s: float = LOCK_S) -> None:
        self.folder, self._kept, self._lock_s = folder, stored, lock_s

    def bundle(self, version: ModelVersion) -> Path:
        """Where a version's bundle is, or would be.

        Raises:
            BundleIntegrityError: the version has no digest.
            StorageError: its name is none that may become a folder's.
        """
        return self._place(version) / _BUNDLE

    def mark(self, version: ModelVersion) -> tuple[int, int] | None:
        """What tells a version's folder apart from a later one in its place; None where there is none."""
        try:
            found = self._place(version).stat()
        except OSError:
            return None
        return found.st_ino, found.st_ctime_ns

    def download(self, version: ModelVersion, download: Callable[[ModelVersion, Path], Path]) -> None:
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
                _write(whole / _VERSION, version)
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
        found = [_read(path, name) for path in self.folder.glob(f"{name}/*/{_VERSION}")]
        return sorted((one for one in found if one is not None), key=lambda version: version.created_ms)

    def names(self) -> list[str]:
        """Models of which versions are on disk, in alphabetical order."""
        return sorted({path.parents[1].name for path in self.folder.glob(f"*/*/{_VERSION}")})

    def last_champion(self, name: str) -> ModelVersion | None:
        """The champion of a model when the registry was last there."""
        return _read(self.folder / name / _CHAMPION, name) if is_model_name(name) else None

    def remember_champion(self, version: ModelVersion) -> None:
        """Keep a version as the last known champion of its model.

        Raises:
            StorageError: the cache cannot be written.
        """
        place = self._place(version).with_name(_CHAMPION)
        try:
            _write(place, version)
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
            with holding(self.folder / f".{name}.lock", busy, self._lock_s, look_every_s=0.02):
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
            for path in found[self._kept :]:
                if path.parent not in safe:
                    _delete(path.parent)

    def _place(self, version: ModelVersion) -> Path:
        _check_name(version.name)
        if re.fullmatch("[0-9a-f]{64}", version.digest) is None:
            raise BundleIntegrityError(
                f"{version} was registered without a digest",
                expected="64 hexadecimal digits",
                got=repr(version.digest)[:100],
                remedy="register the bundle again",
            )
        return self.folder / version.name / f"{version.number}-{version.digest[:16]}"


class BundleCache:
    """Open bundles by version; safe to share between threads.

    A version is loaded once however many ask for it: downloaded where it is not on disk, verified, opened.
    A slow download delays no version that is on disk, and no request's version delays the champion.

    Args:
        disk: where downloaded versions are.
        registry: where they are downloaded from; None for a store that loads nothing.
        verify: takes a bundle's folder and its digest; raises BundleError for one that is not sound, and
            ServiceError where nobody could look at it.
        capacity: bundles kept in memory, the least recently used dropped first.
        clock: seconds, monotonic.
        trusted_key: of whose owner bundles have to be signed, PEM file; None for any.
    """

    def __init__(
        self,
        disk: DiskCache,
        registry: ModelReader | None,
        verify: Callable[[Path, str], object],
        capacity: int,
        clock: Callable[[], float] = time.monotonic,
        trusted_key: Path | None = None,
    ) -> None:
        self.disk, self._trusted_key = disk, trusted_key
        self._registry, self._verify, self._capacity, self._clock = registry, verify, capacity, clock
        self._open: OrderedDict[Key, Bundle] = OrderedDict()
        self._pending: dict[Key, Future[Bundle]] = {}
        # By key: the error, until when it is the answer, and how often in turn the bundle was refused.
        self._failed: MutableMapping[Key, tuple[CspaceError, float, int]] = LRUCache(_REMEMBERED)
        # By digest: equal sums are equal bytes, so what was verified once need not be again.
        self._verified: MutableMapping[str, bool] = LRUCache(_REMEMBERED)
        self._lock = Lock()
        # Each for the versions of requests and for the champion: one download, and one verification.
        self._downloading, self._verifying = (Lock(), Lock()), (Lock(), Lock())

    def peek(self, version: ModelVersion, *, use: bool = True) -> Bundle | None:
        """The version's bundle if it is in memory; ``use`` says whether this is a use of it."""
        key = key_of(version)
        with self._lock:
            if use and key in self._open:
                self._open.move_to_end(key)
            return self._open.get(key)

    def start(self, version: ModelVersion, *, first: bool = False) -> "Future[Bundle]":
        """The version's bundle, now or later: this waits for nothing.

        Args:
            version: which.
            first: whether it waits for none that requests have named, as for the champion.

        Returns:
            A future that raises BundleError for a bundle that is refused, RegistryError for one that cannot
            be downloaded, StorageError for a cache that cannot be written, and ModelNotReadyError if too many
            are on their way already.
        """
        key, future = key_of(version), Future[Bundle]()
        bundle = self.peek(version)
        with self._lock:
            error, until_s, _ = self._failed.get(key, (None, 0.0, 0))
            if bundle is not None:
                future.set_result(bundle)
            elif error is not None and self._clock() < until_s:
                future.set_exception(error)
            elif key in self._pending:
                return self._pending[key]
            elif len(self._pending) >= MAX_PENDING and not first:
                future.set_exception(
                    ModelNotReadyError(
                        "too many models are being fetched", remedy="ask again in some seconds"
                    )
                )
            else:
                # A thread that cannot be started raises, and nothing is pending then.
                Thread(target=self._settle, args=(version, future, first), name="load", daemon=True).start()
                self._pending[key] = future
        return future

    def _settle(self, version: ModelVersion, future: "Future[Bundle]", first: bool) -> None:
        bundle: Bundle | None = None
        error: CspaceError | None = None
        try:
            bundle = self._load(version, self._downloading[first], self._verifying[first])
        except CspaceError as caught:
            error = caught
        except Exception as caught:  # noqa: BLE001 - whoever waits has to be told
            error = NotVerifiedError("a model could not be loaded", got=type(caught).__name__)
        key = key_of(version)
        with self._lock:
            self._pending.pop(key, None)
            if bundle is not None:
                self._open[key] = bundle
                while len(self._open) > self._capacity:
                    self._open.popitem(last=False)
            elif error is not None:
                times = self._failed.get(key, (error, 0.0, 0))[2]
                wait_s = SOON_S
                if isinstance(error, BundleError):
                    wait_s, times = min(RETRY_S * 2.0**times, LONGEST_RETRY_S), times + 1
                self._failed[key] = error, self._clock() + wait_s, times
        if bundle is not None:
            future.set_result(bundle)
        else:
            future.set_exception(error)

    def _load(self, version: ModelVersion, downloading: Lock, verifying: Lock) -> Bundle:
        damage: BundleError | None = None
        for _ in range(_ATTEMPTS):
            mark = self.disk.mark(version)
            is_new = mark is None
            if is_new:
                try:
                    with downloading:
                        self.disk.download(version, self._download)
                except RegistryError as error:
                    # What was wrong with the copy says more than that there is no other.
                    raise (damage or error) from None
                mark = self.disk.mark(version)
            try:
                with verifying:
                    return self._checked(version)
            except BundleError as error:
                damage = error
                # Unless another process has taken it away in between.
                if mark is not None and mark == self.disk.mark(version):
                    self.disk.remove(version)
                    if is_new:
                        raise
        raise damage if damage is not None else AssertionError("unreachable")

    def _download(self, version: ModelVersion, folder: Path) -> Path:
        if self._registry is None:
            raise RegistryUnavailableError(f"there is no registry that has {version}")
        return self._registry.download(version, folder)

    def _checked(self, version: ModelVersion) -> Bundle:
        folder = self.disk.bundle(version)
        try:
            if version.digest not in self._verified:
                self._verify(folder, version.digest)
            if self._trusted_key is not None:
                require_signature(folder, version, self._trusted_key)
        except ServiceError as error:
            raise NotVerifiedError(
                f"{version} cannot be verified", got=error.got, remedy="ask again in some seconds"
            ) from None
        bundle = Bundle.load(folder, digest=version.digest, check=False)
        with self._lock:
            self._verified[version.digest] = True
        self.disk.touch(version)
        return bundle


def _read(path: Path, name: str) -> ModelVersion | None:
    """A version's description; None when it is missing, damaged or another model's: it is only a copy."""
    try:
        version = _DESCRIPTION.validate_json(read_bounded(path, MAX_DESCRIPTION_BYTES, StorageError))
    except (StorageError, ValidationError):
        return None
    return version if version.name == name else None


def _write(path: Path, version: ModelVersion) -> None:
    with replacing(path) as beside:
        beside.write_bytes(_DESCRIPTION.dump_json(version))


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
