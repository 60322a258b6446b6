"""The check of what ``ray job submit --working-dir`` uploads, before it does."""

import logging
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from cspace.errors import ConfigError

_LOG = logging.getLogger(__name__)
_MIB = 2**20
# Of what Ray's head takes. A file may grow until it is read.
_NEAR = 0.95
# What an archive adds to a file, and to each character of its path.
_ENTRY_BYTES, _CHARACTER_BYTES = 76, 2
_NAMED = 3


def check_upload(working_dir: str | None = None, **submitted: Any) -> None:
    """Ends ``ray job submit`` where its working directory is too large to be uploaded.

    Ray calls this where ``RAY_JOB_SUBMIT_HOOK`` names it, as ``python -m services.local env`` does.

    Args:
        working_dir: as it was given; what is not a folder is left to Ray.
        submitted: the other arguments of ``ray job submit``.
    """
    del submitted
    if working_dir is None or not Path(working_dir).is_dir():
        return
    try:
        require_uploadable(Path(working_dir))
    except ConfigError as error:
        sys.exit(f"error: {error}")


def require_uploadable(folder: Path) -> None:
    """Refuse a folder that Ray's head would not take with its code, whose archive is not compressed.

    Raises:
        ConfigError: it is too large; its largest parts are named.
    """
    from ray._private.ray_constants import DASHBOARD_CLIENT_MAX_SIZE  # noqa: PLC0415

    sizes = uploaded_bytes(folder)
    total, limit = sum(sizes.values()), _NEAR * DASHBOARD_CLIENT_MAX_SIZE
    if total <= limit:
        return
    largest = ", ".join(f"{name} {size / _MIB:.0f} MiB" for name, size in sizes.most_common(_NAMED))
    raise ConfigError(
        f"{folder.absolute()} is too large to be uploaded with a job",
        expected=f"at most {limit / _MIB:.0f} MiB",
        got=f"{total / _MIB:.0f} MiB, of which {largest}",
        remedy="name in .rayignore what the job does not need, or move it elsewhere; a job reads data sets "
        "where they are, by data_folder=/absolute/path",
    )


def uploaded_bytes(folder: Path) -> Counter[str]:
    """Bytes in the archive of a working directory, by the names in it; Ray decides what is left out."""
    from ray._private.ray_constants import RAY_RUNTIME_ENV_IGNORE_GITIGNORE  # noqa: PLC0415
    from ray._private.runtime_env.packaging import _dir_travel  # noqa: PLC0415

    folder, sizes = folder.absolute(), Counter[str]()

    def add(path: Path) -> None:
        if path.is_file():
            inside = path.relative_to(folder)
            archived = path.stat().st_size + _ENTRY_BYTES + _CHARACTER_BYTES * len(os.fsencode(inside))
            sizes[inside.parts[0]] += archived

    honoured = os.environ.get(RAY_RUNTIME_ENV_IGNORE_GITIGNORE, "0") != "1"
    _dir_travel(folder, [], add, include_gitignore=honoured, logger=_LOG)
    return sizes
