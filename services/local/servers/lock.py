"""One command at a time starts or ends the services of a state folder."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cspace.errors import ServiceError


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; the system frees it when the process ends, however it ends.

    Raises:
        ServiceError: another command holds it.
    """
    with (folder / "lock").open("a") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ServiceError(
                "another command is starting or ending these services",
                remedy="wait for it, then run yours again",
            ) from error
        yield
