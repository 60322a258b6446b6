"""Files: bounded reads, atomic writes, lock files, and untrusted .npy files."""

import fcntl
import io
import json
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import CspaceError, StorageError

# How the names of half-written things begin and end, for those who clear up after killed processes.
HALF_PREFIX, HALF_SUFFIX = ".write-", ".tmp"
# What Git and Ray read to leave files out.
IGNORE_FILE, IGNORE_ALL = ".gitignore", "*\n"


def read_bounded(
    path: Path, most_bytes: int, error: type[CspaceError], *, remedy: str | None = None
) -> bytes:
    """What a file, a pipe or a device holds, where it is not too much."""
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as problem:
        # A name with a zero byte is no value that a system takes.
        got = getattr(problem, "strerror", None) or str(problem)
        raise error(f"{path} cannot be read", expected="a file", got=got, remedy=remedy) from problem
    if len(data) > most_bytes:
        raise error(f"{path} is too large", expected=f"at most {most_bytes} bytes", got="more")
    return data


@contextmanager
def replacing(path: Path, what: str | None = None) -> Iterator[Path]:
    """A path beside another, for a file or a folder that takes its place when the block ends well.

    ``path``: where it is to be; a file there is replaced, a folder that is not empty is not.
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
    """Write plain values as JSON, whole or not at all."""
    with replacing(path) as beside:
        beside.write_text(json.dumps(values, indent=indent), encoding="utf-8")


@contextmanager
def holding(path: Path, busy: CspaceError, wait_s: float = 0.0, look_every_s: float = 0.2) -> Iterator[None]:
    """Hold a lock file, which is made when it is not there and stays; threads exclude each other, too.

    The system frees it when the process ends, however it ends.
    """
    until_s = time.monotonic() + wait_s
    with path.open("a", encoding="utf-8") as handle:
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= until_s:
                    raise busy from None
                time.sleep(look_every_s)
        yield


def make_output_folder(folder: Path) -> None:
    """Make a folder for output that ignores itself, with its parents.

    A folder that holds something already is left as it is: it may be the user's own.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.iterdir()):
        ignore(folder)


def ignore(folder: Path) -> None:
    """Write a ``.gitignore`` into a folder so that Git and ``ray job submit --working-dir`` leave it out."""
    (folder / IGNORE_FILE).write_text(IGNORE_ALL, encoding="utf-8")


def discard(path: Path) -> None:
    """Delete a file or a folder, as far as that goes, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def read_npy(data: bytes, types: tuple[str, ...], axes: int | tuple[int, ...]) -> NDArray[Any]:
    """An untrusted ``.npy`` file of version 1.0; the array shares its memory.

    ``types``: that the array may have, as ``.npy`` writes them: ``<f4``. ``axes``: number of the array's
    axes, or those that it may have.
    """
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("an array of another version")
    shape, is_fortran, kind = np.lib.format.read_array_header_1_0(stream, max_header_size=512)
    if kind.str not in types or len(shape) not in ((axes,) if isinstance(axes, int) else axes):
        raise ValueError(f"an array of type {kind} and shape {shape}")
    found = np.frombuffer(data, dtype=kind, offset=stream.tell())
    return found.reshape(shape, order="F" if is_fortran else "C")


def map_npy(path: Path, error: type[CspaceError]) -> NDArray[Any]:
    """A ``.npy`` file as a read-only array that is mapped, so that no shape is larger than its file."""
    try:
        mapped: NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
    except Exception as problem:
        # All, for there is no list of what evaluating a header raises.
        got = str(problem)[:200] or type(problem).__name__
        raise error(f"{path} is no array", expected="a .npy file of numbers", got=got) from problem
    return mapped
