"""A whole stack under a name, ports and secrets of its own, beside whatever else the engine runs."""

import os
import secrets
import shutil
import socket
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

UP_LIMIT_S = 1200
JOB_LIMIT_S = 1500
DOCKER = shutil.which("docker") or "docker"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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

    def url(self, part: str) -> str:
        return f"http://127.0.0.1:{self.environment[f'CSPACE_{part}_PORT']}"

    def compose(self, *arguments: str, limit_s: float = 120) -> str:
        """Run one command; the standard output. Raises AssertionError with both outputs when it fails."""
        outcome = subprocess.run(
            [DOCKER, "compose", *arguments],
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

    def down(self) -> None:
        self.compose("--profile", "jobs", "down", "--volumes", "--remove-orphans", "--timeout", "20")
