"""A real MLflow server for tests: on SQLite, on a free loopback port, ended by its process id."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

START_S = 90.0
LOOK_S = 0.2


class MlflowServer:
    """A server on a port of its own that can be ended, hard or soft, and started again on what it left.

    Args:
        folder: of its database, artifacts and log.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it answers."""
        log = self.folder / "server.log"
        command = [sys.executable, "-m", "mlflow", "server", "--workers", "1", "--host", "127.0.0.1"]
        command += ["--port", str(self.port), "--backend-store-uri", f"sqlite:///{self.folder / 'mlflow.db'}"]
        command += ["--artifacts-destination", str(self.folder / "artifacts")]
        environment = {
            **os.environ,
            "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
            "MLFLOW_DISABLE_TELEMETRY": "true",
            "OMP_NUM_THREADS": "1",
        }
        with log.open("ab") as out:
            self._process = subprocess.Popen(
                command, stdout=out, stderr=out, cwd=self.folder, env=environment, start_new_session=True
            )
        _wait(self._process, self.address, log)

    def end(self, number: int = signal.SIGTERM) -> None:
        """End it by a signal; nothing where it does not run."""
        if self._process is not None:
            # It is the leader of its own group, which holds its workers and nobody else.
            os.killpg(self._process.pid, number)
            self._process.wait(30)
            self._process = None


@contextmanager
def mlflow_server(folder: Path) -> Iterator[str]:
    """Run a server whose state lies in ``folder``; yields its address."""
    server = MlflowServer(folder)
    try:
        server.start()
        yield server.address
    finally:
        server.end()


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait(process: subprocess.Popen[bytes], address: str, log: Path) -> None:
    for _ in range(int(START_S / LOOK_S)):
        try:
            process.wait(LOOK_S)
        except subprocess.TimeoutExpired:
            if _answers(address):
                return
        else:
            break
    raise RuntimeError(f"the server did not come up:\n{log.read_text()}")


def _answers(address: str) -> bool:
    try:
        with urlopen(f"{address}/health", timeout=5) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError):
        return False
