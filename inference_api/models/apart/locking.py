"""A lock between processes that the kernel releases when its holder dies."""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cspace.errors import StorageError

_LOOK_S = 0.02


@contextmanager
def locked(path: Path, wait_s: float) -> Iterator[None]:
    """Hold a lock file, which is made when it is not there and stays; threads exclude each other, too.

    Args:
        path: of the file; its folder must be there.
        wait_s: for whoever holds it.

    Raises:
        StorageError: it is held for longer.
        OSError: the file cannot be opened.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        _take(descriptor, time.monotonic() + wait_s)
        yield
    finally:
        os.close(descriptor)


def _take(descriptor: int, until_s: float) -> None:
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise StorageError(
                    "the model cache is in use",
                    expected="one process at a time to change a model's versions",
                    got="another one that takes long",
                    remedy="ask again, or give each server a CSPACE_MODEL_CACHE of its own",
                ) from None
            time.sleep(_LOOK_S)
        else:
            return
