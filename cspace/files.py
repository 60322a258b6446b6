"""Files and folders that appear whole or not at all: written beside their place, then renamed."""

import json
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from cspace.errors import StorageError

# How the names of half-written things begin and end, for those who clear up after killed processes.
HALF_PREFIX, HALF_SUFFIX = ".write-", ".tmp"


@contextmanager
def replacing(path: Path, what: str | None = None) -> Iterator[Path]:
    """A path beside another, for a file or a folder that takes its place when the block ends well.

    Args:
        path: where it is to be; a file there is replaced, a folder that is not empty is not.
        what: is written, for the message.

    Raises:
        StorageError: it cannot be written; without ``what`` an OSError is passed on as it is.
    """
    # Processes on several machines may write the same file at the same time.
    beside = path.with_name(f"{HALF_PREFIX}{path.name}-{secrets.token_hex(4)}{HALF_SUFFIX}")
    try:
        yield beside
        beside.replace(path)
    except OSError as error:
        if what is None:
            raise
        raise StorageError(
            f"{what} cannot be written",
            expected=f"room and rights where {path.name} is to be",
            got=error.strerror or type(error).__name__,
        ) from error
    finally:
        discard(beside)


def write_json(path: Path, values: Mapping[str, Any], indent: int | None = None) -> None:
    """Write plain values as JSON, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as beside:
        beside.write_text(json.dumps(values, indent=indent), encoding="utf-8")


def discard(path: Path) -> None:
    """Delete a file or a folder, as far as that goes, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()
