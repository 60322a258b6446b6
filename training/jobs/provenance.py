"""Where a model comes from: commit and command."""

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cspace.bundle import Provenance

UNKNOWN = "unknown"
SOURCES = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class SourceState:
    """The state of the source tree."""

    commit: str
    dirty: bool | None


def source_state(folder: Path = SOURCES) -> SourceState:
    """The state of the sources in a folder, of this code unless given.

    A submitted job may run from an uploaded copy without history. Where ``CSPACE_GIT_DIR`` names the history
    that it was copied from, the copy is compared with that; else ``CSPACE_GIT_COMMIT`` names the commit.
    """
    own = folder / ".git"
    history = own if own.exists() else os.environ.get("CSPACE_GIT_DIR", "")
    git = ["git", "--no-optional-locks", f"--git-dir={history}", f"--work-tree={folder}"]
    # What was not uploaded is missing from the copy and no change.
    commands = (["rev-parse", "HEAD"], ["diff", "--name-only", "--diff-filter=M", "HEAD"])
    try:
        commit, changed = (
            subprocess.run([*git, *command], capture_output=True, text=True, check=True, timeout=20).stdout
            for command in commands
        )
    except (OSError, subprocess.SubprocessError):
        return SourceState(os.environ.get("CSPACE_GIT_COMMIT", UNKNOWN), None)
    return SourceState(commit.strip(), bool(changed.strip()))


def job_tags(preset: str, seed: int, script: str) -> dict[str, str]:
    """What a job's run is found by, and what MLflow's UI shows as its source."""
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


def provenance(config: Mapping[str, Any], **known: Any) -> Provenance:
    """How a bundle was made that this process makes now."""
    source = source_state()
    return Provenance(
        git_commit=source.commit,
        git_dirty=source.dirty,
        config=config,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command_line(),
        **known,
    )
