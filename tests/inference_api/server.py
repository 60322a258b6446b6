"""A real server process on a free loopback port, ended by its process id."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

ROOT = Path(__file__).parents[2]
START_S = 60.0
LOOK_S = 0.1


@dataclass(frozen=True)
class ServerProcess:
    """A server that runs, or ran.

    Args:
        address: as ``http://127.0.0.1:PORT``.
        process: ended when the context is left, unless it has ended before.
        log: what it has printed.
    """

    address: str
    process: subprocess.Popen[bytes]
    log: Path


@contextmanager
def api_server(
    folder: Path, settings: Mapping[str, str], *, python: str = sys.executable, root: Path = ROOT
) -> Iterator[str]:
    """As :func:`server_process`; yields its address alone."""
    with server_process(folder, settings, python=python, root=root) as server:
        yield server.address


@contextmanager
def server_process(
    folder: Path,
    settings: Mapping[str, str],
    *arguments: str,
    python: str = sys.executable,
    root: Path = ROOT,
) -> Iterator[ServerProcess]:
    """Run ``python -m inference_api``; yields it once it is alive, and sees to its end with 0.

    Args:
        folder: for its output and its cache.
        settings: of the environment.
        arguments: of the command, after the port.
        python: the interpreter.
        root: where the packages are.
    """
    kept = {name: os.environ[name] for name in ("PATH", "LANG", "TMPDIR") if name in os.environ}
    environment = {
        **kept,
        "HOME": str(folder),
        "PYTHONPATH": str(root),
        "PYTHONUNBUFFERED": "1",
        "CSPACE_MODEL_CACHE": str(folder / "cache"),
        "MLFLOW_DISABLE_TELEMETRY": "true",
        # Two seconds of computing for each server, of which few are asked for plans.
        "CSPACE_API_LOAD_PLANNER": "0",
        **settings,
    }
    log = folder / "server.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [python, "-m", "inference_api", "--port", "0", *arguments],
            stdout=out,
            stderr=out,
            cwd=folder,
            env=environment,
        )
    try:
        yield ServerProcess(_wait(process, log), process, log)
    finally:
        process.terminate()
        code = process.wait(30)
    assert code == 0, log.read_text()


def _wait(process: subprocess.Popen[bytes], log: Path) -> str:
    for _ in range(int(START_S / LOOK_S)):
        try:
            process.wait(LOOK_S)
        except subprocess.TimeoutExpired:
            found = re.search(r"running on (http://\S+)", log.read_text())
            if found and _lives(found[1]):
                return found[1]
        else:
            break
    process.kill()
    raise RuntimeError(f"the server did not come up:\n{log.read_text()}")


def _lives(address: str) -> bool:
    try:
        return httpx.get(f"{address}/health/live", timeout=5).status_code == 200
    except httpx.TransportError:
        return False
