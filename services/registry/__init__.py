"""MLflow: tracking, registered models, signatures, promotion."""

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

from cspace.errors import ConfigError

if TYPE_CHECKING:
    from services.registry.models import ModelRegistry
    from services.registry.tracking import Tracking


def tracking_uri(
    environment: Mapping[str, str] = os.environ, remedy: str = '`eval "$(make -s env)"` sets it'
) -> str:
    """Of MLFLOW_TRACKING_URI; a ConfigError where it is not set."""
    if uri := environment.get("MLFLOW_TRACKING_URI", ""):
        return uri
    raise ConfigError(
        "MLFLOW_TRACKING_URI is not set", expected="the tracking server's address", remedy=remedy
    )


def connect(uri: str) -> tuple["Tracking", "ModelRegistry"]:
    """Runs and models on a tracking server."""
    # MLflow takes seconds to import.
    from services.registry.models import ModelRegistry  # noqa: PLC0415
    from services.registry.tracking import Tracking  # noqa: PLC0415

    return Tracking(uri), ModelRegistry(uri)
