"""One command at a time starts or ends the services of a state folder."""

from contextlib import AbstractContextManager
from pathlib import Path

from cspace.errors import ServiceError
from cspace.files import holding


def exclusive(folder: Path) -> AbstractContextManager[None]:
    """Hold the lock of a folder.

    Raises:
        ServiceError: another command holds it.
    """
    busy = ServiceError(
        "another command is starting or ending these services", remedy="wait for it, then run yours again"
    )
    return holding(folder / "lock", busy)
