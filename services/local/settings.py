"""Settings of the services of one machine, and the environment of shells that use them."""

import hashlib
import os
import sys
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from cspace.errors import ConfigError
from services.outcomes import FOLDER as OUTCOMES
from services.planner.client import API_URL

HOST = "127.0.0.1"
ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
# What supervisord's configuration would read as more than a part of a path.
SPECIAL = frozenset("\"'\\;#%\n")

Port = Annotated[int, Field(ge=1, le=65535)]


def _default_home() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "cspace-sampler"


class Settings(BaseSettings):
    """Where the services keep their state, and on which loopback ports they listen."""

    model_config = SettingsConfigDict(env_prefix="CSPACE_", env_ignore_empty=True, frozen=True)

    home: Path = Field(default_factory=_default_home)
    api_port: Port = 8000
    ray_port: Port = 8265
    mlflow_port: Port = 5000
    viewer_port: Port = 8090
    # Local trials run beside each other, so that even one core offers two places.
    ray_cpus: int = Field(default_factory=lambda: max(2, len(os.sched_getaffinity(0))), ge=1, le=1024)

    @field_validator("home")
    @classmethod
    def _own_folder(cls, home: Path) -> Path:
        # `clean-state` deletes below this folder.
        shared = {Path.home(), ROOT, *Path.home().parents, *ROOT.parents}
        if not home.is_absolute() or home in shared or home.is_file() or SPECIAL & set(str(home)):
            raise ValueError(f"expected an absolute folder of its own, without any of {''.join(SPECIAL)!r}")
        return home

    def url(self, name: str) -> str:
        """Address of ``api``, ``ray``, ``mlflow`` or ``viewer``."""
        return f"http://{HOST}:{getattr(self, f'{name}_port')}"

    @property
    def temp_folder(self) -> Path:
        """Folder of Ray's session and of sockets, whose paths have to be short."""
        digest = hashlib.sha256(os.fsencode(self.home)).hexdigest()[:8]
        return Path(f"/tmp/cspace-{os.getuid()}-{digest}")  # noqa: S108

    @property
    def socket(self) -> Path:
        """Where supervisord listens."""
        return self.temp_folder / "supervisor.sock"


def read_settings() -> Settings:
    """The settings from the environment; an empty variable counts as not set."""
    try:
        return Settings()
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"the setting CSPACE_{str(first['loc'][0]).upper()} is wrong",
            expected=first["msg"],
            got=repr(first["input"]),
            remedy="change it in the environment, or unset it for its default",
        ) from error


def shell_values(settings: Settings) -> dict[str, str]:
    """The environment variables with which `ray job submit` and the project's commands find the services."""
    return {
        "RAY_AUTH_MODE": "token",
        "RAY_ADDRESS": settings.url("ray"),
        API_URL: settings.url("api"),
        OUTCOMES: str(settings.home / "data" / "outcomes"),
        "MLFLOW_TRACKING_URI": settings.url("mlflow"),
        "MLFLOW_DISABLE_TELEMETRY": "true",
        # Progress bars and addresses turn a log into noise.
        "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
        "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    }


def proxy_exceptions() -> dict[str, str]:
    """The variables that except loopback addresses from every proxy."""
    return {
        name: ",".join(filter(None, [os.environ.get(name), HOST, "localhost"]))
        for name in ("NO_PROXY", "no_proxy")
    }
