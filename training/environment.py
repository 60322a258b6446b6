"""What a job reads from the environment."""

import os
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Environment:
    """Where a job works: the tracking server and the data folder (absolute, shared by all nodes)."""

    tracking_uri: str
    data_folder: Path


def job_environment() -> Environment:
    """MLFLOW_TRACKING_URI and CSPACE_DATA_DIR, which the Ray head of ``make up`` hands to its jobs.

    Raises:
        ConfigError: one is missing, or the folder is not absolute.
    """
    uri, folder = os.environ.get("MLFLOW_TRACKING_URI", ""), os.environ.get("CSPACE_DATA_DIR", "")
    remedy = "submit to the Ray head of `make up`, which sets both, or export them"
    if not uri:
        raise ConfigError(
            "MLFLOW_TRACKING_URI is not set", expected="the tracking server's address", remedy=remedy
        )
    if not Path(folder).is_absolute():
        raise ConfigError(
            "CSPACE_DATA_DIR does not fit", expected="an absolute folder", got=repr(folder), remedy=remedy
        )
    return Environment(uri, Path(folder))
