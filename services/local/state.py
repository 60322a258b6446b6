"""The state folder: how big it is, and dropping it."""

import shutil
from pathlib import Path

from cspace.errors import StorageError
from cspace.files import IGNORE_ALL, IGNORE_FILE
from services.local.marker import MARKER, owned
from services.local.servers.ray_head import temp_folder
from services.local.settings import FOLDERS, Settings


def size_bytes(folder: Path) -> int:
    """Sum over the files below a folder, 0 where there is none; links are not followed."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.lstat().st_size if not path.is_dir() else 0
        except OSError:  # deleted in between
            continue
    return total


def size_text(count: int) -> str:
    """A number of bytes for people."""
    size = float(count)
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.0f} {unit}"
        size /= 1000
    return f"{size:.1f} GB"


def state_parts(settings: Settings) -> dict[Path, int]:
    """What :func:`drop_state` would delete, with its size in bytes.

    Raises:
        ConfigError: the state folder is not this project's.
    """
    parts = [settings.home / name for name in owned(settings.home, FOLDERS)]
    return {part: size_bytes(part) for part in [*parts, temp_folder(settings)] if part.is_dir()}


def drop_state(settings: Settings) -> None:
    """Delete the parts of the state folder, and the folder itself if nothing else lies in it.

    Raises:
        ConfigError: it is not this project's.
        StorageError: something cannot be deleted.
    """
    parts = state_parts(settings)
    try:
        for part in parts:
            shutil.rmtree(part)
        ignored = settings.home / IGNORE_FILE
        if ignored.is_file() and ignored.read_text(encoding="utf-8", errors="replace") == IGNORE_ALL:
            ignored.unlink()
        # Last, so that what was interrupted can be repeated.
        (settings.home / MARKER).unlink(missing_ok=True)
        if settings.home.is_dir() and not any(settings.home.iterdir()):
            settings.home.rmdir()
    except OSError as error:
        raise StorageError("the state folder cannot be deleted", got=str(error)) from error
