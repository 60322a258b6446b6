"""The role ``lookups``: what a child asks the registry."""

from collections.abc import Mapping
from typing import Any

from inference_api.models.apart.processes.serving import Jobs
from inference_api.models.apart.registry import import_registry, registry_at
from inference_api.models.version_files import to_values


def jobs(configuration: Mapping[str, Any]) -> Jobs:
    """The three lookups of the registry at ``registry_uri``."""
    uri: str = configuration["registry_uri"]
    import_registry()

    def version(name: str, number: int) -> dict[str, Any]:
        return to_values(registry_at(uri).version(name, number))

    def by_alias(name: str, alias: str) -> dict[str, Any]:
        return to_values(registry_at(uri).by_alias(name, alias))

    def versions(name: str) -> list[dict[str, Any]]:
        return [to_values(one) for one in registry_at(uri).versions(name)]

    return {"version": version, "by_alias": by_alias, "versions": versions}
