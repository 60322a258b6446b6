"""The state folder: made for this user alone, marked as the project's, measured and deleted."""

import shutil
from contextlib import suppress
from pathlib import Path

from cspace.errors import ConfigError, StorageError
from services.local.settings import Settings

MARKER, IGNORE = ".cspace-sampler.json", ".gitignore"
FOLDERS = ("mlflow", "data", "logs", "run", "figures", "models", "arms")


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
        raise ConfigError(
            f"{home} is not a state folder of this project",
            expected="a new or an empty folder",
            got=", ".join(found[:5]),
            remedy="set CSPACE_HOME to a folder of its own",
        )
