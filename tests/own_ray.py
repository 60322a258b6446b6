"""The project's commands in processes that start a Ray of their own, whatever else runs on this machine."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run_alone(uri: str, data: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """A command of Python's, with its tracking server and its data folder."""
    environment = os.environ | {
        "MLFLOW_TRACKING_URI": uri,
        "CSPACE_DATA_DIR": str(data),
        "PYTHONPATH": str(ROOT),
        "RAY_ADDRESS": "local",
        "RAY_AUTH_MODE": "disabled",
        "RAY_USAGE_STATS_ENABLED": "0",
        "MLFLOW_DISABLE_TELEMETRY": "true",
        "OMP_NUM_THREADS": "1",
    }
    return subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, check=False, timeout=600
    )
