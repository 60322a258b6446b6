"""Where a model comes from: commit, state of the tree, command, time."""

import os
import subprocess
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class SourceState:
    """The state of the source tree.

    Args:
        commit: the commit's name, or "unknown" outside a checkout.
        dirty: whether tracked files differ from it; None outside a checkout.
    """

    commit: str
    dirty: bool | None


def source_state() -> SourceState:
    """The state of the checkout that this code runs from.

    A submitted job may run in a copy without history; ``CSPACE_GIT_COMMIT`` then names the commit.
    """
    commit = _git("rev-parse", "HEAD")
    if commit is None:
        return SourceState(os.environ.get("CSPACE_GIT_COMMIT", UNKNOWN), None)
    changes = _git("status", "--porcelain", "--untracked-files=no")
    return SourceState(commit, bool(changes))


def command_line() -> str:
    """The command as a reader can type it again."""
    return " ".join(["python", *sys.argv])


def now() -> str:
    """The time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _git(*arguments: str) -> str | None:
    folder = Path(__file__).resolve().parent.parent
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],  # noqa: S607 - git is found where the user has it
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
