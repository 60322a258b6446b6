"""The tracking server and registry that a command's environment names."""

from collections.abc import Mapping

from cspace.errors import ConfigError
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking


def connect(environment: Mapping[str, str]) -> tuple[Tracking, ModelRegistry]:
    """Both on MLFLOW_TRACKING_URI."""
    uri = environment.get("MLFLOW_TRACKING_URI", "")
    if not uri:
        raise ConfigError("no tracking server is named", remedy="set MLFLOW_TRACKING_URI")
    return Tracking(uri), ModelRegistry(uri)
