"""A whole stack under a name, ports and secrets of its own, beside whatever else the engine runs."""

import json
import os
import secrets
import shutil
import socket
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

UP_LIMIT_S = 1200
JOB_LIMIT_S = 1500
DOCKER = shutil.which("docker") or "docker"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def engine(*arguments: str) -> str:
    """Run one command of the engine; its output. Raises CalledProcessError when it fails."""
    outcome = subprocess.run([DOCKER, *arguments], capture_output=True, text=True, check=True, timeout=60)
    return outcome.stdout.strip()


@dataclass(frozen=True)
class Stack:
    """`docker compose` with the environment of one test run."""

    root: Path
    environment: Mapping[str, str] = field(repr=False)  # it holds the secrets

    @classmethod
    def unique(cls, root: Path) -> "Stack":
        name = f"cspace-test-{secrets.token_hex(4)}"
        ports = {f"CSPACE_{part}_PORT": str(free_port()) for part in ("API", "MLFLOW", "RAY")}
        own = {"COMPOSE_PROJECT_NAME": name, "CSPACE_RAY_TOKEN": secrets.token_hex(32)}
        return cls(root, {**os.environ, **ports, **own, "CSPACE_POSTGRES_PASSWORD": secrets.token_hex(16)})

    @classmethod
    @contextmanager
    def lent(cls, root: Path) -> Iterator["Stack"]:
        """A stack that leaves nothing behind; what came up is up to the borrower."""
        stack = cls.unique(root)
        try:
            yield stack
        finally:
            stack.down("--volumes")

    def url(self, part: str) -> str:
        return f"http://127.0.0.1:{self.environment[f'CSPACE_{part}_PORT']}"

    def command(self, *arguments: str) -> list[str]:
        """A command of Compose, for the root and the environment of this stack."""
        return [DOCKER, "compose", *arguments]

    def compose(self, *arguments: str, limit_s: float = 120) -> str:
        """Run one command; the standard output. Raises AssertionError with both outputs when it fails."""
        outcome = subprocess.run(
            self.command(*arguments),
            cwd=self.root,
            env=dict(self.environment),
            capture_output=True,
            text=True,
            check=False,
            timeout=limit_s,
        )
        said = f"{outcome.stdout[-6000:]}\n{outcome.stderr[-6000:]}"
        assert outcome.returncode == 0, f"docker compose {' '.join(arguments)}: {outcome.returncode}\n{said}"
        return outcome.stdout

    def up(self) -> None:
        try:
            self.compose("up", "--build", "--wait", limit_s=UP_LIMIT_S)
        except AssertionError as failure:
            raise AssertionError(f"{failure}\n{self.compose('logs', '--tail', '60')}") from failure

    def job(self, service: str, *arguments: str) -> str:
        """Run a one-shot job and return its log."""
        return self.compose("run", "--rm", "--no-TTY", service, *arguments, limit_s=JOB_LIMIT_S)

    def result(self, service: str, *arguments: str) -> Mapping[str, Any]:
        """Run a one-shot job; what the last line of its log says to programs."""
        return self.read_result(self.job(service, *arguments))

    @staticmethod
    def read_result(log: str) -> Mapping[str, Any]:
        """What a job's log says to programs."""
        lines = [line for line in log.splitlines() if line.startswith("RESULT ")]
        assert lines, log[-4000:]
        result = json.loads(lines[-1].removeprefix("RESULT "))
        assert isinstance(result, dict)
        return result

    def start(self) -> None:
        """Start what does not run, from images that are there, and wait until all of it is healthy."""
        self.compose("up", "--no-build", "--wait", limit_s=UP_LIMIT_S)

    def container(self, service: str) -> str:
        """The id of a service's only container."""
        (found,) = self.compose("ps", "--all", "--quiet", service).split()
        return found

    def disconnect(self, service: str) -> None:
        """Take a service's only container off the cluster's network."""
        engine("network", "disconnect", self._network, self.container(service))

    def connect(self, service: str) -> None:
        """Put it back, as Compose had connected it."""
        engine("network", "connect", "--alias", service, self._network, self.container(service))

    @property
    def _network(self) -> str:
        return f"{self.environment['COMPOSE_PROJECT_NAME']}_cluster"

    def started_at(self, service: str) -> str:
        """When a service's only container was started last."""
        return engine("inspect", "--format", "{{.State.StartedAt}}", self.container(service))

    def down(self, *options: str) -> None:
        self.compose("--profile", "jobs", "down", "--remove-orphans", "--timeout", "20", *options)
