"""What services and jobs find in their environment, and what a shell needs to submit jobs."""

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path

from services.local.settings import Settings
from services.planner.sources.address import API_URL

_NO_PROXY = ("127.0.0.1", "localhost")
# What a user's shell says about other clusters and servers would lead jobs astray; his token is his.
_DROPPED = ("RAY_", "MLFLOW_", "PYTHONHOME")
_KEPT = ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")


def service_environment(settings: Settings, base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of the services, which the Ray head hands on to its jobs."""
    kept = {name: value for name, value in base.items() if name in _KEPT or not name.startswith(_DROPPED)}
    return without_proxy(kept) | {
        "CSPACE_DATA_DIR": str(settings.data_folder),
        # Jobs that run from an uploaded copy of the sources, without history, tell their commit by this.
        "CSPACE_GIT_DIR": str(settings.root / ".git"),
        "CSPACE_MODEL_CACHE": str(settings.home / "models"),
        "MLFLOW_DISABLE_TELEMETRY": "true",
        # Progress bars turn a log into noise.
        "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
        "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
        "MLFLOW_TRACKING_URI": settings.mlflow_url,
        "OMP_NUM_THREADS": "1",
        # onnxruntime reports on its use from the import on, unless told not to.
        "ORT_DISABLE_TELEMETRY": "1",
        "PATH": _path(base),
        "PYTHONPATH": str(settings.root),
        "PYTHONUNBUFFERED": "1",
        "RAY_AUTH_MODE": "token",
        # Trials say the same of themselves, and each line counts.
        "RAY_DEDUP_LOGS": "0",
        # `ray job stop` gives a job this long to write its checkpoints.
        "RAY_JOB_STOP_WAIT_TIME_S": "20",
        # Without this, Ray takes 127.0.0.1 for the machine's outer address and listens there. The switch is
        # named after the systems on which a head keeps to the loopback address by default.
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        "RAY_USAGE_STATS_ENABLED": "0",
    }


def without_proxy(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with loopback addresses excepted from every proxy."""
    changed = dict(environment)
    for name in ("NO_PROXY", "no_proxy"):
        listed = [part for part in environment.get(name, "").split(",") if part]
        changed[name] = ",".join(listed + [host for host in _NO_PROXY if host not in listed])
    return changed


def shell_lines(settings: Settings) -> list[str]:
    """Lines that set a shell up for `ray job submit` and the project's commands."""
    values = {
        "RAY_AUTH_MODE": "token",
        "RAY_ADDRESS": settings.ray_url,
        "RAY_JOB_SUBMIT_HOOK": "services.local.upload.check_upload",
        API_URL: settings.api_url,
        "MLFLOW_TRACKING_URI": settings.mlflow_url,
        "MLFLOW_DISABLE_TELEMETRY": "true",
        "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
        "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    }
    lines = [f"export {name}={shlex.quote(value)}" for name, value in values.items()]
    return [*lines, f'export PATH={shlex.quote(str(binaries()))}:"$PATH"']


def binaries() -> Path:
    """The folder of the environment's programs."""
    return Path(sys.executable).parent


def _path(base: Mapping[str, str]) -> str:
    return os.pathsep.join([str(binaries()), base.get("PATH") or os.defpath])
