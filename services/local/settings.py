"""Settings of the services of one machine, read from the environment once, at the edge."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ConfigError
from services.local.marker import claim

HOST = "127.0.0.1"
API_PORT = "CSPACE_API_PORT"
RAY_PORT = "CSPACE_RAY_PORT"
MLFLOW_PORT = "CSPACE_MLFLOW_PORT"
RAY_CPUS = "CSPACE_RAY_CPUS"
HOME = "CSPACE_HOME"
FOLDERS = ("mlflow", "data", "logs", "run", "figures", "models")

_ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class Settings:
    """Where the services of this machine keep their state and on which loopback ports they listen.

    Args:
        home: the state folder, absolute.
        root: the project's root: what jobs run in.
        api_port: of the inference API.
        ray_port: of Ray's dashboard and jobs API.
        mlflow_port: of the tracking server and its UI.
        ray_cpus: what the Ray head offers to trials and tasks.
    """

    home: Path
    root: Path
    api_port: int = 8000
    ray_port: int = 8265
    mlflow_port: int = 5000
    ray_cpus: int = 2

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ, root: Path = _ROOT) -> "Settings":
        """Read ``CSPACE_HOME`` and the ``CSPACE_*_PORT`` settings; an empty one counts as not set.

        Raises:
            ConfigError: a value is not what the setting takes.
        """
        settings = cls(
            home=_home(environment, root),
            root=root,
            api_port=_number(environment, API_PORT, 8000, 1, 65535),
            ray_port=_number(environment, RAY_PORT, 8265, 1, 65535),
            mlflow_port=_number(environment, MLFLOW_PORT, 5000, 1, 65535),
            # The local trials run beside each other, so even one core offers two places.
            ray_cpus=_number(environment, RAY_CPUS, max(2, _cores()), 1, 1024),
        )
        settings.require_distinct_ports()
        return settings

    @property
    def data_folder(self) -> Path:
        """Data sets and what jobs keep between runs."""
        return self.home / "data"

    @property
    def logs_folder(self) -> Path:
        """One log file a service."""
        return self.home / "logs"

    @property
    def run_folder(self) -> Path:
        """Records of the running processes."""
        return self.home / "run"

    @property
    def figures_folder(self) -> Path:
        """Pictures that the main job drew."""
        return self.home / "figures"

    @property
    def api_url(self) -> str:
        """Address of the inference API."""
        return f"http://{HOST}:{self.api_port}"

    @property
    def ray_url(self) -> str:
        """Address of Ray's dashboard and jobs API."""
        return f"http://{HOST}:{self.ray_port}"

    @property
    def mlflow_url(self) -> str:
        """Address of the tracking server and its UI."""
        return f"http://{HOST}:{self.mlflow_port}"

    def make_folders(self) -> None:
        """Make the state folder, for this user alone, with its parts.

        Raises:
            ConfigError: it cannot be made, or is somebody else's.
        """
        try:
            claim(self.home, FOLDERS)
            for name in FOLDERS:
                (self.home / name).mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(
                "the state folder cannot be made", got=str(error), remedy=f"set {HOME} to a folder of yours"
            ) from error

    def require_distinct_ports(self) -> None:
        """Raise ConfigError where two services share a port."""
        names = {API_PORT: self.api_port, RAY_PORT: self.ray_port, MLFLOW_PORT: self.mlflow_port}
        if len(set(names.values())) < len(names):
            raise ConfigError(
                "two services share a port",
                expected="three different ports",
                got=", ".join(f"{name}={port}" for name, port in names.items()),
            )


def _home(environment: Mapping[str, str], root: Path) -> Path:
    user = Path(environment.get("HOME") or Path.home())
    state = Path(environment.get("XDG_STATE_HOME") or user / ".local" / "state")
    home = Path(environment.get(HOME) or state / "cspace-sampler").expanduser()
    if not home.is_absolute():
        raise _wrong(HOME, "an absolute folder", str(home))
    # `clean-state` deletes below this folder: it must be one that holds nothing else.
    if home in {user, root} or home in user.parents or home in root.parents:
        raise _wrong(HOME, "a folder of its own", str(home))
    if home.exists() and not home.is_dir():
        raise _wrong(HOME, "a folder", f"the file {home}")
    return home


def _number(environment: Mapping[str, str], name: str, default: int, low: int, high: int) -> int:
    text = environment.get(name) or str(default)
    number = int(text) if text.isascii() and text.isdecimal() else low - 1
    if not low <= number <= high:
        raise _wrong(name, f"a whole number from {low} to {high}", text)
    return number


def _wrong(name: str, expected: str, got: str) -> ConfigError:
    return ConfigError(
        f"the setting {name} is wrong",
        expected=expected,
        got=repr(got),
        remedy=f"set {name} in the environment, or unset it for its default",
    )


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
