"""Verifies bundles in a worker process with limits of time and memory.

A bundle's graphs may compute for hours or eat memory, and neither can be interrupted within a process. The
server, the commands on models, the evaluator and training verify what comes from a registry here before
anything of it runs in their own process.
"""

import math
from pathlib import Path

from cspace import bounded
from cspace.bundle.load import Bundle
from cspace.bundle.runtime import container_bytes
from cspace.errors import BundleError

VERIFY_S = 30.0
# Beyond what the worker holds with its libraries; in a container at most this share of its limit.
MEMORY_BYTES, CONTAINER_SHARE = 2**30, 0.25


def verify(folder: Path, digest: str | None = None, limit_s: float = VERIFY_S) -> str:
    """The digest of a bundle whose sums, digest, graphs and golden case hold in a worker process."""
    limits = bounded.Limits(memory_bytes(), math.ceil(limit_s), limit_s)
    found: str = bounded.call(
        checked_digest,
        str(folder.absolute()),
        digest,
        limits=limits,
        what="the bundle",
        error=BundleError,
        remedy="export it again",
    )
    return found


def checked_digest(folder: str, digest: str | None) -> str:
    """The digest of a bundle that loads with all checks; to be called in a worker."""
    return Bundle.load(Path(folder), digest=digest).digest


def load_verified(folder: Path, digest: str | None = None) -> Bundle:
    """Verify a bundle in a worker process, then open it here."""
    return Bundle.load(folder, digest=verify(folder, digest), check=False)


def memory_bytes() -> int:
    """What a worker may take beyond its libraries."""
    container = container_bytes()
    return MEMORY_BYTES if container is None else min(MEMORY_BYTES, int(container * CONTAINER_SHARE))
