"""What a job reads from the environment."""

import os
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Environment:
    """Where a job works.

    Args:
        tracking_uri: the tracking server's address.
        data_folder: absolute, on storage that all nodes share.
        patience_s: how long the job's driver waits for a tracking server that is away.
    """

    tracking_uri: str
    data_folder: Path
    patience_s: float = 600.0


def job_environment() -> Environment:
    """MLFLOW_TRACKING_URI and CSPACE_DATA_DIR, which the Ray head of ``make up`` hands to its jobs.

    CSPACE_TRACKING_PATIENCE_S, where it is set, is how long a job waits for a tracking server that is away.

    Raises:
        ConfigError: one is missing or no number, or the folder is not absolute.
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
    patience = os.environ.get("CSPACE_TRACKING_PATIENCE_S") or "600"
    try:
        return Environment(uri, Path(folder), float(patience))
    except ValueError as error:
        raise ConfigError(
            "CSPACE_TRACKING_PATIENCE_S does not fit", expected="seconds", got=repr(patience)
        ) from error
