"""A Ray head, an MLflow server and a training job as processes of their own, each of which can be killed."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import psutil

from services.names import MODEL_NAME
from tests.contracts.mlflow_server import MlflowServer, free_port

ROOT = Path(__file__).resolve().parents[2]
START_S = 60.0
LOOK_S = 0.1
# A worker that trains is called by Tune's method.
_TRIAL = re.compile(r"ray::.*\.train")
# Steps between two points of a curve; twice as many between two checkpoints.
EVERY = 25


@dataclass(frozen=True)
class Kind:
    """A kind of job, small enough to be struck many times.

    Args:
        preset: that it starts from.
        model: that its versions are of.
        settings: that all its jobs have.
    """

    preset: str = "smoke"
    model: str = MODEL_NAME
    settings: tuple[str, ...] = ()


def settings(steps: dict[str, int]) -> tuple[str, ...]:
    """The settings of a job with so many steps of each trial."""
    sections = {"local-0": "local", "local-1": "local"}
    numbers = {sections.get(trial, trial): count for trial, count in steps.items()}
    return (
        *(f"{section}.steps={count}" for section, count in numbers.items()),
        f"resources.log_every_steps={EVERY}",
        f"resources.checkpoint_every_steps={2 * EVERY}",
    )


class RayHead:
    """``ray start --head`` with two processors, on loopback, in a folder of its own."""

    def __init__(self) -> None:
        # The path of a Unix socket is short.
        self._folder = Path(tempfile.mkdtemp(prefix="chaos-", dir="/tmp"))
        self._port = free_port()
        self.address = f"127.0.0.1:{self._port}"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until its port is open."""
        command = [str(Path(sys.executable).with_name("ray")), "start", "--head", "--block"]
        command += ["--node-ip-address=127.0.0.1", f"--port={self._port}", "--min-worker-port=0"]
        command += ["--max-worker-port=0", f"--dashboard-agent-listen-port={free_port()}"]
        command += [f"--ray-client-server-port={free_port()}", "--include-dashboard=false", "--num-cpus=2"]
        command += ["--object-store-memory=200000000", f"--temp-dir={self._folder}", "--disable-usage-stats"]
        with (self._folder / "head.log").open("ab") as out:
            self._process = subprocess.Popen(command, stdout=out, stderr=out, env=environment(), cwd=ROOT)
        deadline = time.monotonic() + START_S
        while not self._open():
            assert self._process.poll() is None, (self._folder / "head.log").read_text()
            assert time.monotonic() < deadline, "the Ray head did not come up"
            time.sleep(LOOK_S)

    def workers(self) -> list[psutil.Process]:
        """Processes that run a trial now."""
        return [one for one in self._family() if _TRIAL.match(_title(one))]

    def kill(self) -> None:
        """End it and all that belongs to it at once, as a machine that loses its power."""
        family = self._family()
        for one in family:
            one.kill()
        psutil.wait_procs(family, 30)
        if self._process is not None:
            self._process.wait(30)
        self._process = None

    def close(self) -> None:
        """End it and delete its folder."""
        self.kill()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _family(self) -> list[psutil.Process]:
        if self._process is None:
            return []
        try:
            head = psutil.Process(self._process.pid)
            return [head, *head.children(recursive=True)]
        except psutil.NoSuchProcess:
            return []

    def _open(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._port)) == 0


def _title(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def environment(**own: str) -> dict[str, str]:
    """The test's environment without settings of other clusters and servers."""
    kept = {
        key: value for key, value in os.environ.items() if not key.startswith(("RAY_", "CSPACE_", "MLFLOW_"))
    }
    quiet = {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0", "MLFLOW_DISABLE_TELEMETRY": "true"}
    return {**kept, **quiet, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), **own}


@dataclass
class System:
    """Everything that a job needs, and the means to take it away.

    Args:
        folder: of the server and of the jobs' logs.
        data: the data folder of the jobs.
        kind: of the jobs.
    """

    folder: Path
    data: Path
    kind: Kind = Kind()
    server: MlflowServer = field(init=False)
    head: RayHead = field(init=False)

    def __post_init__(self) -> None:
        self.server, self.head = MlflowServer(self.folder), RayHead()

    def __enter__(self) -> Self:
        self.server.start()
        self.head.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.server.end()
        self.head.close()

    def submit(self, name: str, settings: tuple[str, ...]) -> "Driver":
        """Run a training job's command, as often as wanted under one name."""
        return self.run(name, "cluster_train.py", settings)

    def run(self, name: str, script: str, settings: tuple[str, ...], *options: str) -> "Driver":
        """Run a command of ``training/`` on its kind's preset with settings and options of its own."""
        sets = [part for setting in (*self.kind.settings, *settings) for part in ("--set", setting)]
        path = str(ROOT / "training" / script)
        command = [sys.executable, path, "--preset", self.kind.preset, "--job", name, *sets, *options]
        log = self.folder / f"{name}.log"
        given = environment(
            RAY_ADDRESS=self.head.address,
            MLFLOW_TRACKING_URI=self.server.address,
            CSPACE_DATA_DIR=str(self.data),
        )
        with log.open("ab") as out:
            begins = out.tell()
            return Driver(subprocess.Popen(command, stdout=out, stderr=out, env=given, cwd=ROOT), log, begins)


@dataclass
class Driver:
    """A job's process.

    Args:
        process: of the driver.
        log: of all drivers of the job.
        begins: where this one's part of the log begins.
        began_s: when it was started, by the monotonic clock.
    """

    process: subprocess.Popen[bytes]
    log: Path
    begins: int
    began_s: float = field(default_factory=time.monotonic)

    @property
    def printed(self) -> str:
        """What it has printed so far."""
        return self.log.read_bytes()[self.begins :].decode(errors="replace")

    @property
    def result(self) -> dict[str, Any]:
        """What it prints at its end."""
        found = json.loads(self.printed.rpartition("RESULT ")[2].splitlines()[0])
        assert isinstance(found, dict)
        return found

    def send(self, number: int) -> None:
        """Send a signal."""
        if self.process.poll() is None:
            self.process.send_signal(number)

    def wait(self, limit_s: float = 300.0) -> int:
        """Its exit code."""
        try:
            return self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.send(signal.SIGKILL)
            raise AssertionError(f"the job did not end:\n{self.printed}") from None

    def moments(self) -> Iterator[float]:
        """Seconds since it was started, as long as it runs."""
        while self.process.poll() is None:
            yield time.monotonic() - self.began_s
            time.sleep(LOOK_S)
