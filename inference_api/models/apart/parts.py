"""The registry and the loaders of a store: in children for serving, in this process over a given registry."""

from dataclasses import dataclass, field, replace

from cspace.bundle.verification import VERIFY_S
from cspace.errors import RegistryUnavailableError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import DOWNLOAD_S, LOCK_S, BundleLoader, LoaderApart, LoaderHere
from inference_api.models.apart.lookups import LOOKUP_S, RegistryApart
from inference_api.models.apart.processes.child import Child, ChildLimits
from services.registry.models.port import ModelLookups, ModelRegistry, ModelVersion


@dataclass(frozen=True, slots=True)
class Limits:
    """What lookups, downloads and verifications may take.

    Args:
        lookup_s: for one lookup.
        download_s: for one download.
        verify_s: for one verification.
        child: for each process.
    """

    lookup_s: float = LOOKUP_S
    download_s: float = DOWNLOAD_S
    verify_s: float = VERIFY_S
    child: ChildLimits = field(default_factory=ChildLimits)


@dataclass(frozen=True, slots=True)
class Parts:
    """What a store is made of.

    Args:
        registry: for lookups; None without one.
        loader: downloads and verifies.
        children: the processes that look up and download, in this order.
    """

    registry: ModelLookups | None
    loader: BundleLoader
    children: tuple[Child, ...] = ()


class NoLoader:
    """Of a store without a registry, which loads nothing."""

    def download(self, version: ModelVersion) -> None:
        """There is nowhere to download from."""
        raise RegistryUnavailableError(f"there is no registry that has {version}")

    def verify(self, version: ModelVersion) -> None:
        """As :meth:`download`."""
        self.download(version)


def parts_here(disk: DiskCache, registry: ModelRegistry) -> Parts:
    """All in this process, for a registry that is known to behave."""
    return Parts(registry, LoaderHere(disk, registry))


def parts_apart(disk: DiskCache, uri: str | None, limits: Limits | None = None) -> Parts:
    """All in children; none for no address.

    Args:
        disk: the cache.
        uri: of the tracking server.
        limits: for the work and the processes.
    """
    if uri is None:
        return Parts(None, NoLoader())
    limits = limits or Limits()
    # It is asked every few seconds, and MLflow takes seconds to import: it stays, and a registry that made
    # one late makes the next one late.
    staying = replace(limits.child, idle_s=None, is_patient=False)
    cache = {
        "registry_uri": uri,
        "cache_folder": str(disk.folder.absolute()),
        "stored": disk.kept,
        "lock_s": min(disk.lock_s, LOCK_S, limits.download_s / 2),
    }
    asking = Child("lookups", {"registry_uri": uri}, staying)
    loading = Child("loading", cache, limits.child)
    return Parts(
        RegistryApart(asking, limits.lookup_s),
        LoaderApart(disk, loading, limits.download_s, limits.verify_s),
        (asking, loading),
    )
