"""The role ``loading``: what a child does with bundles that nobody has verified yet."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cspace.bundle.running.runtime import onnx_runtime
from cspace.errors import BundleError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import LoaderHere, verify
from inference_api.models.apart.processes.serving import Jobs
from inference_api.models.apart.registry import import_registry, registry_at
from inference_api.models.version_files import from_values


def jobs(configuration: Mapping[str, Any]) -> Jobs:
    """Download and verify in the cache at ``cache_folder``, from the registry at ``registry_uri``.

    MLflow is imported now if ``downloads`` says that it will be needed.
    """
    cache = DiskCache(Path(configuration["cache_folder"]), configuration["stored"], configuration["lock_s"])
    onnx_runtime()
    if configuration["downloads"]:
        import_registry()

    def download(version: Mapping[str, Any]) -> None:
        LoaderHere(cache, registry_at(configuration["registry_uri"])).download(from_values(version))

    def verified(version: Mapping[str, Any]) -> None:
        try:
            verify(cache, from_values(version))
        except (MemoryError, RecursionError) as error:
            raise BundleError("the bundle needs too much memory", got=type(error).__name__) from error

    return {"download": download, "verify": verified}
