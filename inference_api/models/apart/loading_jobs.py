"""The role ``loading``: what a child does with the registry's files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import LoaderHere
from inference_api.models.apart.processes.serving import Jobs
from inference_api.models.apart.registry import import_registry, registry_at
from inference_api.models.version_files import from_values


def jobs(configuration: Mapping[str, Any]) -> Jobs:
    """Download into the cache at ``cache_folder``, from the registry at ``registry_uri``."""
    cache = DiskCache(Path(configuration["cache_folder"]), configuration["stored"], configuration["lock_s"])
    import_registry()

    def download(version: Mapping[str, Any]) -> None:
        LoaderHere(cache, registry_at(configuration["registry_uri"])).download(from_values(version))

    return {"download": download}
