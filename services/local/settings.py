"""Settings of the services of one machine, their state folder, and the environment of shells."""

import hashlib
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from cspace.errors import ConfigError, StorageError
from services.names import API_URL
from services.outcomes import FOLDER as OUTCOMES

HOST = "127.0.0.1"
ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
# What supervisord's configuration would read as more than a part of a path.
SPECIAL = frozenset("\"'\\;#%\n")
MARKER, IGNORE = ".cspace-sampler.json", ".gitignore"
FOLDERS = ("mlflow", "data", "logs", "run", "figures", "models", "arms")

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
        what = f"the setting CSPACE_{str(first['loc'][0]).upper()} is wrong"
        raise ConfigError(what, expected=first["msg"], got=repr(first["input"])) from error


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


def make_state(settings: Settings) -> None:
    """Make the state folder with its parts; a folder that holds something else is refused."""
    home = settings.home
    try:
        home.mkdir(mode=0o700, parents=True, exist_ok=True)
        _require_own(home)
        (home / MARKER).write_text('{"made_by": "cspace-sampler"}', encoding="utf-8")
        # Git and `ray job submit --working-dir` leave the folder out.
        (home / IGNORE).write_text("*\n", encoding="utf-8")
        for name in FOLDERS:
            (home / name).mkdir(exist_ok=True)
    except OSError as error:
        remedy = "set CSPACE_HOME to a folder of yours"
        raise ConfigError("the state folder cannot be made", got=str(error), remedy=remedy) from error


def state_parts(settings: Settings) -> list[Path]:
    """What :func:`drop_state` would delete."""
    if not settings.home.is_dir():
        return []
    _require_own(settings.home)
    parts = [*(settings.home / name for name in FOLDERS), settings.temp_folder]
    return [part for part in parts if part.is_dir()]


def drop_state(settings: Settings) -> None:
    """Delete the parts of the state folder, and the folder itself if nothing else lies in it."""
    try:
        for part in state_parts(settings):
            shutil.rmtree(part)
        # The mark goes last, so that what was interrupted can be repeated.
        for name in (IGNORE, MARKER):
            (settings.home / name).unlink(missing_ok=True)
        if not any(settings.home.iterdir()):
            settings.home.rmdir()
    except OSError as error:
        raise StorageError("the state folder cannot be deleted", got=str(error)) from error


def size_text(folder: Path) -> str:
    """The size of the files below a folder; links are not followed."""
    total = 0
    for path in folder.rglob("*"):
        with suppress(OSError):  # deleted in between
            total += path.lstat().st_size if not path.is_dir() else 0
    return f"{total / 1e6:.1f} MB"


def _require_own(home: Path) -> None:
    found = sorted(path.name for path in home.iterdir())
    if found and MARKER not in found:
        what, got = f"{home} is not a state folder of this project", ", ".join(found[:5])
        raise ConfigError(what, expected="a new or an empty folder", got=got, remedy="set CSPACE_HOME to one")
