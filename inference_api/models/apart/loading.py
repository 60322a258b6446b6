"""Downloading and verifying bundles: the port, in this process for tests, and in a child for serving."""

import time
from typing import Protocol

from cspace.bundle import Bundle, verification
from cspace.errors import RegistryUnavailableError, ServiceError, StorageBusyError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.processes.child import Child
from inference_api.models.apart.processes.pipes import ChildError
from inference_api.models.version_files import to_values
from services.registry.models.port import ModelRegistry, ModelVersion

DOWNLOAD_S = 90.0
# A child asks again for a folder that another process holds, which may do so for a whole download.
LOCK_S = 5.0


class BundleLoader(Protocol):
    """What brings a version into the cache on disk and tells whether it is sound there."""

    def download(self, version: ModelVersion) -> None:
        """Put a version into the cache on disk; nothing if it is there.

        Raises:
            RegistryError: it cannot be downloaded.
            StorageError: the cache cannot be written.
        """
        ...

    def verify(self, version: ModelVersion) -> None:
        """Hold the version on disk against its sums, the registered digest and its golden case.

        Raises:
            BundleError: it is not sound, it is not the registered one, or it is not there.
        """
        ...


class LoaderHere:
    """The port in this process, which waits for whatever the registry and the bundle do.

    Args:
        disk: the cache.
        registry: where versions are downloaded from.
    """

    def __init__(self, disk: DiskCache, registry: ModelRegistry) -> None:
        self._disk, self._registry = disk, registry

    def download(self, version: ModelVersion) -> None:
        """See :meth:`BundleLoader.download`."""
        self._disk.download(version, self._registry.download)

    def verify(self, version: ModelVersion) -> None:
        """See :meth:`BundleLoader.verify`."""
        Bundle.load(self._disk.bundle(version), digest=version.digest)


class LoaderApart:
    """The port in other processes: a child that downloads, and a worker for each verification.

    Args:
        disk: the cache.
        child: in the role of ``loading``.
        download_s: for a download.
        verify_s: for a verification.
    """

    def __init__(
        self,
        disk: DiskCache,
        child: Child,
        download_s: float = DOWNLOAD_S,
        verify_s: float = verification.VERIFY_S,
    ) -> None:
        self._disk, self._child, self._download_s, self._verify_s = disk, child, download_s, verify_s

    def download(self, version: ModelVersion) -> None:
        """See :meth:`BundleLoader.download`."""
        try:
            self._call_in_turn(version)
        except ChildError as error:
            raise RegistryUnavailableError(
                f"{version} cannot be downloaded",
                expected=f"a whole bundle within {self._download_s:g} s",
                got=str(error),
                remedy="ask again when the registry is well",
            ) from None

    def _call_in_turn(self, version: ModelVersion) -> None:
        """Download when no other process does, which may take as long as a download may."""
        until_s = time.monotonic() + self._download_s + LOCK_S
        while True:
            try:
                self._child.call("download", {"version": to_values(version)}, self._download_s)
            except StorageBusyError:
                if time.monotonic() > until_s:
                    raise
            else:
                return

    def verify(self, version: ModelVersion) -> None:
        """See :meth:`BundleLoader.verify`."""
        try:
            verification.verify(self._disk.bundle(version), version.digest, self._verify_s)
        except ServiceError as error:
            raise NotVerifiedError(
                f"{version} cannot be verified", got=error.got, remedy="ask again in some seconds"
            ) from None


class NotVerifiedError(RegistryUnavailableError):
    """Nobody could look at the bundle, which says nothing about it."""
