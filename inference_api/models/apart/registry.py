"""MLflow, brought in by the children alone, with the patience of a process that serves."""

import os
from functools import cache

from services.registry.models.port import ModelRegistry


def import_registry() -> None:
    """Import MLflow; before the child's memory is bounded."""
    from services.registry.mlflow_health import lower_patience  # noqa: PLC0415 - children alone pay for MLflow

    lower_patience(os.environ)
    import services.registry.models.mlflow_registry  # noqa: F401, PLC0415 - as above


@cache
def registry_at(uri: str) -> ModelRegistry:
    """The registry at an address.

    Raises:
        RegistryError: it is no address.
    """
    import_registry()
    from services.registry.models.mlflow_registry import MlflowRegistry  # noqa: PLC0415 - as above

    return MlflowRegistry(uri)
