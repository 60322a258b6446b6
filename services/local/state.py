"""The state folder: made for this user alone, marked as the project's, measured and deleted."""

import shutil
from pathlib import Path

from cspace.errors import ConfigError, StorageError
from services.local.settings import Settings

MARKER = ".cspace-sampler.json"
IGNORE = ".gitignore"
FOLDERS = ("mlflow", "data", "logs", "run", "figures", "models", "arms")


def make_state(settings: Settings) -> None:
    """Make the state folder with its parts; a folder that holds something else is refused."""
    home = settings.home
    try:
        home.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not (home / MARKER).exists():
            _require_empty(home)
            (home / MARKER).write_text('{"made_by": "cspace-sampler"}', encoding="utf-8")
            # Git and `ray job submit --working-dir` leave the folder out.
            (home / IGNORE).write_text("*\n", encoding="utf-8")
        for name in FOLDERS:
            (home / name).mkdir(exist_ok=True)
    except OSError as error:
        remedy = "set CSPACE_HOME to a folder of yours"
        raise ConfigError("the state folder cannot be made", got=str(error), remedy=remedy) from error


def state_parts(settings: Settings) -> dict[Path, int]:
    """What :func:`drop_state` would delete, with its size in bytes."""
    if not settings.home.is_dir():
        return {}
    if not (settings.home / MARKER).exists():
        _require_empty(settings.home)
    parts = [*(settings.home / name for name in FOLDERS), settings.temp_folder]
    return {part: size_bytes(part) for part in parts if part.is_dir()}


def drop_state(settings: Settings) -> None:
    """Delete the parts of the state folder, and the folder itself if nothing else lies in it."""
    try:
        for part in state_parts(settings):
            shutil.rmtree(part)
        # The mark goes last, so that what was interrupted can be repeated.
        for name in (IGNORE, MARKER):
            (settings.home / name).unlink(missing_ok=True)
        if settings.home.is_dir() and not any(settings.home.iterdir()):
            settings.home.rmdir()
    except OSError as error:
        raise StorageError("the state folder cannot be deleted", got=str(error)) from error


def size_bytes(folder: Path) -> int:
    """Sum over the files below a folder; links are not followed."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.lstat().st_size if not path.is_dir() else 0
        except OSError:  # deleted in between
            continue
    return total


def _require_empty(home: Path) -> None:
    found = sorted(path.name for path in home.iterdir())
    if found:
        raise ConfigError(
            f"{home} is not a state folder of this project",
            expected="a new or an empty folder",
            got=", ".join(found[:5]),
            remedy="set CSPACE_HOME to a folder of its own",
        )
