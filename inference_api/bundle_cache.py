"""Downloaded bundles: on disk for the next start and for when the registry is away, in memory for use.

A version lies at ``<cache>/<name>/<number>-<digest>/`` with its bundle and ``version.json``. The digest is
part of the name because a registry that was set up anew counts its versions from 1 again.
"""

import re
import shutil
import tempfile
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from threading import Lock

from cspace.bundle import Bundle
from cspace.errors import BundleError, BundleIntegrityError, StorageError
from inference_api.version_files import read_version, write_version
from services.registry.models import ModelRegistry, ModelVersion

_BUNDLE = "bundle"
_VERSION = "version.json"
_CHAMPION = "champion.json"
_DIGEST = re.compile(r"[0-9a-f]{64}")


class BundleCache:
    """Bundles by version; safe to share between threads.

    Args:
        folder: the cache on disk; made when first needed.
        capacity: bundles kept in memory, the least recently used dropped first.
        stored: versions of each model kept on disk, likewise, beside its last champion; at least 1.
    """

    def __init__(self, folder: Path, capacity: int, stored: int = 20) -> None:
        self._folder = folder
        self._capacity = capacity
        self._stored = stored
        self._loaded: OrderedDict[tuple[str, int, str], Bundle] = OrderedDict()
        self._lock = Lock()
        self._loading = Lock()

    def get(self, version: ModelVersion, registry: ModelRegistry) -> Bundle:
        """The version's bundle from memory, disk or the registry, whichever has it first.

        Raises:
            BundleError: the bundle is refused.
            RegistryError: it has to be downloaded and can not.
            StorageError: the cache cannot be written.
        """
        key = (version.name, version.number, version.digest)
        bundle = self._in_memory(key)
        if bundle is not None:
            return bundle
        with self._loading:
            bundle = self._in_memory(key) or self._load(version, registry)
            with self._lock:
                self._loaded[key] = bundle
                while len(self._loaded) > self._capacity:
                    self._loaded.popitem(last=False)
        return bundle

    def is_loaded(self, version: ModelVersion) -> bool:
        """Whether the version is in memory."""
        with self._lock:
            return (version.name, version.number, version.digest) in self._loaded

    def stored(self, name: str) -> list[ModelVersion]:
        """Versions of a model that are on disk, oldest first."""
        found = [read_version(path) for path in self._folder.glob(f"{name}/*/{_VERSION}")]
        return sorted((version for version in found if version), key=lambda version: version.created_ms)

    def last_champion(self, name: str) -> ModelVersion | None:
        """The champion of a model when the registry was last there."""
        return read_version(self._folder / name / _CHAMPION)

    def remember_champion(self, version: ModelVersion) -> None:
        """Keep a version as the last known champion of its model.

        Raises:
            StorageError: the cache cannot be written.
        """
        try:
            write_version(self._folder / version.name / _CHAMPION, version)
        except OSError as error:
            raise _not_writable(self._folder, error) from error

    def _in_memory(self, key: tuple[str, int, str]) -> Bundle | None:
        with self._lock:
            if key in self._loaded:
                self._loaded.move_to_end(key)
            return self._loaded.get(key)

    def _load(self, version: ModelVersion, registry: ModelRegistry) -> Bundle:
        place = self._place(version)
        if (place / _BUNDLE).is_dir():
            try:
                bundle = _checked(Bundle.load(place / _BUNDLE), version)
            except BundleError:
                # A damaged copy is fetched anew.
                shutil.rmtree(place, ignore_errors=True)
            else:
                # Its time tells when it was used last; a cache that is read only keeps the old one.
                with suppress(OSError):
                    (place / _VERSION).touch()
                return bundle
        try:
            self._download(version, registry, place)
        except OSError as error:
            raise _not_writable(self._folder, error) from error
        try:
            bundle = _checked(Bundle.load(place / _BUNDLE), version)
        except BundleError:
            shutil.rmtree(place, ignore_errors=True)
            raise
        self._prune(version.name, place)
        return bundle

    def _prune(self, name: str, newest: Path) -> None:
        """Delete the versions of a model that were not used for longest, beyond those that are kept."""
        champion = self.last_champion(name)
        safe = {newest} if champion is None else {newest, self._place(champion)}
        with suppress(OSError):
            found = sorted(
                self._folder.glob(f"{name}/*/{_VERSION}"),
                key=lambda path: path.stat().st_mtime_ns,
                reverse=True,
            )
            for path in found[self._stored :]:
                if path.parent not in safe:
                    shutil.rmtree(path.parent, ignore_errors=True)

    def _download(self, version: ModelVersion, registry: ModelRegistry, place: Path) -> None:
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".download-", dir=place.parent) as temporary:
            beside = Path(temporary)
            got = registry.download(version, beside / "download")
            whole = beside / "whole"
            whole.mkdir()
            got.rename(whole / _BUNDLE)
            write_version(whole / _VERSION, version)
            if not place.exists():
                whole.rename(place)

    def _place(self, version: ModelVersion) -> Path:
        if _DIGEST.fullmatch(version.digest) is None:
            raise BundleIntegrityError(
                f"{version.name}/{version.number} was registered without a digest",
                expected="64 hexadecimal digits",
                got=repr(version.digest)[:100],
                remedy="register the bundle again",
            )
        return self._folder / version.name / f"{version.number}-{version.digest[:16]}"


def _checked(bundle: Bundle, version: ModelVersion) -> Bundle:
    if version.digest != bundle.digest:
        raise BundleIntegrityError(
            f"the bundle of {version.name}/{version.number} is not the one that was registered",
            expected=f"digest {version.digest}",
            got=bundle.digest,
        )
    return bundle


def _not_writable(folder: Path, error: OSError) -> StorageError:
    return StorageError(
        "the model cache cannot be written",
        expected=f"room and rights at {folder}",
        got=str(error),
        remedy="free some space, or set CSPACE_MODEL_CACHE to another folder",
    )
