"""Settings of the services of one machine, and the environment of services, jobs and shells."""

import hashlib
import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from cspace.errors import ConfigError
from services.outcomes import FOLDER as OUTCOMES
from services.planner.client import API_URL

HOST = "127.0.0.1"
PREFIX = "CSPACE_"
ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent

Port = Annotated[int, Field(ge=1, le=65535)]


def _default_home() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "cspace-sampler"


def _default_cpus() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    # Local trials run beside each other, so that even one core offers two places.
    return max(2, cores)


class Settings(BaseSettings):
    """Where the services keep their state, and on which loopback ports they listen."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True, frozen=True, extra="ignore")

    home: Path = Field(default_factory=_default_home)
    api_port: Port = 8000
    ray_port: Port = 8265
    mlflow_port: Port = 5000
    viewer_port: Port = 8090
    ray_cpus: Annotated[int, Field(ge=1, le=1024)] = Field(default_factory=_default_cpus)

    @field_validator("home")
    @classmethod
    def _own_folder(cls, home: Path) -> Path:
        home = home.expanduser()
        # `clean-state` deletes below this folder. supervisord takes ` ;` and ` #` for comments.
        shared = home in {Path.home(), ROOT} or home in Path.home().parents or home in ROOT.parents
        comment = any(part in str(home) for part in ("\n", " ;", " #"))
        if not home.is_absolute() or shared or comment or (home.exists() and not home.is_dir()):
            raise ValueError("expected an absolute path of a folder of its own")
        return home

    @model_validator(mode="after")
    def _distinct_ports(self) -> Self:
        if len(set(self.ports.values())) < len(self.ports):
            found = ", ".join(f"{name}={port}" for name, port in self.ports.items())
            raise ValueError(f"two services share a port: {found}")
        return self

    @property
    def ports(self) -> dict[str, int]:
        """The ports by their environment variables."""
        return {
            setting_name(name): getattr(self, name)
            for name in ("api_port", "ray_port", "mlflow_port", "viewer_port")
        }

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

    @property
    def temp_folder(self) -> Path:
        """Folder of sockets, whose paths have to be short, and of Ray's session."""
        digest = hashlib.sha256(os.fsencode(self.home)).hexdigest()[:8]
        return Path(f"/tmp/cspace-{os.getuid()}-{digest}")  # noqa: S108


def setting_name(field: str) -> str:
    """The environment variable of a field."""
    return f"{PREFIX}{field.upper()}"


def read_settings() -> Settings:
    """The settings from the environment; an empty variable counts as not set."""
    try:
        return Settings()
    except ValidationError as error:
        first = error.errors()[0]
        name = setting_name(str(first["loc"][0])) if first["loc"] else f"{PREFIX}*_PORT"
        raise ConfigError(
            f"the setting {name} is wrong: {first['msg']}",
            got=repr(first["input"]) if first["loc"] else None,
            remedy="change it in the environment, or unset it for its default",
        ) from error


def service_environment(settings: Settings, base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of the services, which the Ray head hands on to its jobs."""
    # What a user's shell says about other clusters and servers would lead jobs astray; his token is his.
    foreign, kept = ("RAY_", "MLFLOW_", "PYTHONHOME"), ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")
    own = {name: value for name, value in base.items() if name in kept or not name.startswith(foreign)}
    return without_proxy(own) | {
        f"{PREFIX}DATA_DIR": str(settings.home / "data"),
        # Jobs that run from an uploaded copy of the sources, without history, tell their commit by this.
        f"{PREFIX}GIT_DIR": str(ROOT / ".git"),
        f"{PREFIX}MODEL_CACHE": str(settings.home / "models"),
        # Empty switches it off; another folder would be that of another state folder.
        OUTCOMES: "" if base.get(OUTCOMES) == "" else str(settings.home / "data" / "outcomes"),
        **_mlflow_environment(settings),
        "OMP_NUM_THREADS": "1",
        # onnxruntime reports on its use from the import on, unless told not to.
        "ORT_DISABLE_TELEMETRY": "1",
        "PATH": os.pathsep.join([str(BIN), base.get("PATH") or os.defpath]),
        "PYTHONPATH": str(ROOT),
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


def _mlflow_environment(settings: Settings) -> dict[str, str]:
    return {
        "MLFLOW_TRACKING_URI": settings.mlflow_url,
        "MLFLOW_DISABLE_TELEMETRY": "true",
        # Progress bars and addresses turn a log into noise.
        "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
        "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    }


def without_proxy(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with loopback addresses excepted from every proxy."""
    changed = dict(environment)
    for name in ("NO_PROXY", "no_proxy"):
        listed = [part for part in environment.get(name, "").split(",") if part]
        changed[name] = ",".join([*listed, *(host for host in (HOST, "localhost") if host not in listed)])
    return changed


def shell_lines(settings: Settings) -> list[str]:
    """Lines that set a shell up for `ray job submit` and the project's commands."""
    values = {
        "RAY_AUTH_MODE": "token",
        "RAY_ADDRESS": settings.ray_url,
        API_URL: settings.api_url,
        OUTCOMES: str(settings.home / "data" / "outcomes"),
        **_mlflow_environment(settings),
    }
    lines = [f"export {name}={shlex.quote(value)}" for name, value in values.items()]
    return [*lines, f'export PATH={shlex.quote(str(BIN))}:"$PATH"']
