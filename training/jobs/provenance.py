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
    """The state of the sources that this code runs from.

    A submitted job may run from an uploaded copy without history. Where ``CSPACE_GIT_DIR`` names the history
    that it was copied from, the copy is compared with that; else ``CSPACE_GIT_COMMIT`` names the commit.
    """
    folder = Path(__file__).resolve().parents[2]
    return (
        _checkout(("-C", str(folder)))
        or _copy(os.environ.get("CSPACE_GIT_DIR"), folder)
        or SourceState(os.environ.get("CSPACE_GIT_COMMIT", UNKNOWN), None)
    )


def job_tags(preset: str, seed: int, script: str) -> dict[str, str]:
    """What a job's run is found by, and what MLflow's UI shows as its source.

    Args:
        preset: of its configuration.
        seed: likewise.
        script: in the project's folder.
    """
    source = source_state()
    return {
        "preset": preset,
        "seed": str(seed),
        "git.commit": source.commit,
        "git.dirty": str(source.dirty),
        "mlflow.source.git.commit": source.commit,
        "mlflow.source.name": script,
        "mlflow.source.type": "JOB",
    }


def _checkout(where: tuple[str, ...]) -> SourceState | None:
    commit = _git(*where, "rev-parse", "HEAD")
    changes = _git(*where, "status", "--porcelain", "--untracked-files=no")
    return None if commit is None or changes is None else SourceState(commit, bool(changes))


def _copy(history: str | None, folder: Path) -> SourceState | None:
    if not history:
        return None
    where = ("--no-optional-locks", f"--git-dir={history}", f"--work-tree={folder}")
    commit = _git(*where, "rev-parse", "HEAD")
    # What was not uploaded is missing from the copy and no change.
    changes = _git(*where, "diff", "--name-only", "--diff-filter=M", "HEAD")
    return None if commit is None or changes is None else SourceState(commit, bool(changes))


def command_line() -> str:
    """The command as a reader can type it again in the project's folder, whatever folder that was here."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is not None:
        program = ["-m", spec.name.removesuffix(".__main__")]
    else:
        script, project = Path(sys.argv[0]), Path(__file__).resolve().parents[2]
        inside = script.is_absolute() and script.is_relative_to(project)
        program = [str(script.relative_to(project) if inside else script)]
    return " ".join(["python", *program, *sys.argv[1:]])


def now() -> str:
    """The time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", *arguments],  # noqa: S607 - git is found where the user has it
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
