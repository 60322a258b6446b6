"""The services of one machine with a state folder, a token and ports of their own, through their commands."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from services.local.stack import SERVICES, Settings, connect, free_ports, leftovers

ROOT = Path(__file__).parents[2]
FOREIGN = ("CSPACE_", "MLFLOW_", "RAY_", "PYTEST_")
LIMIT_S = 400.0


@dataclass(frozen=True)
class LocalStack:
    """Commands of ``python -m services.local`` under one set of settings."""

    environment: dict[str, str]

    @classmethod
    def unique(cls, folder: Path) -> "LocalStack":
        kept = {name: value for name, value in os.environ.items() if not name.startswith(FOREIGN)}
        ports = zip(("API", "RAY", "MLFLOW"), free_ports(3), strict=True)
        own = {f"CSPACE_{name}_PORT": str(port) for name, port in ports}
        home = folder / "user"
        home.mkdir()
        own |= {"CSPACE_HOME": str(folder / "state"), "CSPACE_RAY_CPUS": "1", "HOME": str(home)}
        return cls(kept | own)

    @property
    def settings(self) -> Settings:
        fields = Settings.model_fields
        given = {name: self.environment.get(f"CSPACE_{name.upper()}") for name in fields}
        return Settings(**{name: value for name, value in given.items() if value})

    def run(self, *arguments: str, limit_s: float = LIMIT_S) -> subprocess.CompletedProcess[str]:
        """One command, its output and errors together."""
        return self._execute([sys.executable, "-m", "services.local", *arguments], limit_s)

    def succeed(self, *arguments: str, limit_s: float = LIMIT_S) -> str:
        outcome = self.run(*arguments, limit_s=limit_s)
        assert outcome.returncode == 0, f"{arguments} ended with {outcome.returncode}\n{outcome.stdout}"
        return outcome.stdout

    def shell(self, script: str, limit_s: float = LIMIT_S) -> subprocess.CompletedProcess[str]:
        """A script in a shell that was set up as the project tells its users."""
        setup = f'eval "$({sys.executable} -m services.local env)"'
        return self._execute(["/bin/bash", "-c", f"{setup}\n{script}"], limit_s)

    def pids(self) -> dict[str, int]:
        infos = connect(self.settings).getAllProcessInfo()
        return {info["name"]: info["pid"] for info in infos if info["name"] in SERVICES}

    def processes(self) -> set[psutil.Process]:
        """All that runs for this stack."""
        return leftovers(self.settings)

    @contextmanager
    def running(self) -> Iterator["LocalStack"]:
        """Up, and down again whatever happens; the state goes too."""
        try:
            self.succeed("up")
            yield self
        finally:
            self.run("down")
            shutil.rmtree(self.settings.temp_folder, ignore_errors=True)

    def _execute(self, command: list[str], limit_s: float) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=ROOT,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            timeout=limit_s,
        )
