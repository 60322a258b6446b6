"""All services of one machine in a state folder and on ports of their own, for the blocks that need them."""

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.contracts.mlflow_server import free_port
from tests.docs.blocks import ROOT
from tests.docs.shell import shell_environment

UP_LIMIT_S = 600
PORTS = {"API": 8000, "RAY": 8265, "MLFLOW": 5000}


@dataclass(frozen=True)
class LiveStack:
    """A running stack: the settings that name it, and what takes the place of the documented addresses."""

    folder: Path
    settings: Mapping[str, str]
    replaced: Mapping[str, str]


@contextmanager
def live_stack() -> Iterator[LiveStack]:
    """Bring everything up, end it afterwards by the project's own command."""
    # Not pytest's folder, whose name is longer than a socket's path may be.
    with tempfile.TemporaryDirectory(prefix="docs-") as name:
        folder = Path(name)
        ports = {part: str(free_port()) for part in PORTS}
        settings = {f"CSPACE_{part}_PORT": port for part, port in ports.items()}
        settings["CSPACE_HOME"] = str(folder / "state")
        replaced = {f"127.0.0.1:{PORTS[part]}": f"127.0.0.1:{port}" for part, port in ports.items()}
        try:
            _local("up", folder, settings)
            yield LiveStack(folder, settings, replaced)
        finally:
            _local("down", folder, settings)


def _local(command: str, folder: Path, settings: Mapping[str, str]) -> None:
    outcome = subprocess.run(
        [sys.executable, "-m", "services.local", command],
        cwd=ROOT,
        env=shell_environment(folder) | dict(settings),
        capture_output=True,
        text=True,
        check=False,
        timeout=UP_LIMIT_S,
    )
    assert outcome.returncode == 0, f"{command}\n{outcome.stdout}\n{outcome.stderr}"
