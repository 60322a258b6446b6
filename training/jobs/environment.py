"""What a job reads from its environment, and where its model comes from: commit, command, time."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cspace.bundle import Provenance
from cspace.errors import ConfigError
from services.registry.connection import tracking_uri


@dataclass(frozen=True, slots=True)
class Environment:
    """Where a job works."""

    tracking_uri: str
    data_folder: Path
    patience_s: float = 600.0


def job_environment() -> Environment:
    """MLFLOW_TRACKING_URI and CSPACE_DATA_DIR, which the Ray head of ``make up`` hands to its jobs.

    CSPACE_TRACKING_PATIENCE_S, where it is set, is how long a job waits for a tracking server that is away.
    """
    folder = os.environ.get("CSPACE_DATA_DIR", "")
    remedy = "submit to the Ray head of `make up`, which sets both, or export them"
    uri = tracking_uri(remedy=remedy)
    if not Path(folder).is_absolute():
        raise ConfigError(
            "CSPACE_DATA_DIR does not fit", expected="an absolute folder", got=repr(folder), remedy=remedy
        )
    patience = os.environ.get("CSPACE_TRACKING_PATIENCE_S") or "600"
    try:
        return Environment(uri, Path(folder), float(patience))
    except ValueError as error:
        raise ConfigError(
            "CSPACE_TRACKING_PATIENCE_S does not fit", expected="seconds", got=repr(patience)
        ) from error


# A job's configuration, child runs, name and what it starts from.
RECORD = "job.json"


def job_folder(environment: Environment, run_id: str) -> Path:
    """Where the job of a run keeps its trials."""
    return environment.data_folder / "jobs" / Path(run_id).name


def pointer(environment: Environment, name: str) -> Path:
    """The file that tells the run of the job of a name."""
    return environment.data_folder / "jobs" / "names" / f"{name}.json"


def run_of(environment: Environment, name: str) -> str | None:
    """The run of the job of this name; None where none was submitted under it."""
    try:
        return str(json.loads(pointer(environment, name).read_text(encoding="utf-8"))["run_id"])
    except FileNotFoundError:
        return None


UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class SourceState:
    """The state of the source tree."""

    commit: str
    dirty: bool | None


def source_state() -> SourceState:
    """The state of the sources that this code runs from.

    A submitted job may run from an uploaded copy without history. Where ``CSPACE_GIT_DIR`` names the history
    that it was copied from, the copy is compared with that; else ``CSPACE_GIT_COMMIT`` names the commit.
    """
    folder = Path(__file__).resolve().parents[2]
    found = _compared(["-C", str(folder)], ["status", "--porcelain", "--untracked-files=no"])
    history = os.environ.get("CSPACE_GIT_DIR")
    if found is None and history:
        # What was not uploaded is missing from the copy and no change.
        where = ["--no-optional-locks", f"--git-dir={history}", f"--work-tree={folder}"]
        found = _compared(where, ["diff", "--name-only", "--diff-filter=M", "HEAD"])
    return found or SourceState(os.environ.get("CSPACE_GIT_COMMIT", UNKNOWN), None)


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


def _compared(where: Sequence[str], changes: Sequence[str]) -> SourceState | None:
    """The state of a source tree, by git's commands that name its commit and list changes; None without."""
    commit, changed = _git(*where, "rev-parse", "HEAD"), _git(*where, *changes)
    return None if commit is None or changed is None else SourceState(commit, bool(changed))


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


# How Ray hands a submitted job its metadata.
_VARIABLE = "RAY_JOB_CONFIG_JSON_ENV_VAR"


def submission_id(environment: Mapping[str, str] = os.environ) -> str | None:
    """Ray's id of the submission; None where the process was started in another way."""
    try:
        return str(json.loads(environment[_VARIABLE])["metadata"]["job_submission_id"])
    except (LookupError, TypeError, ValueError):
        return None


def explanation(submission: str | None) -> tuple[str, ...]:
    """What whoever follows the job's log should know of it, in lines; none without a submission."""
    if submission is None:
        return ()
    return (
        f"submission: {submission}. Ctrl-C, or closing the terminal, ends this log and not the job.",
        f"  to stop the job:         ray job stop {submission}",
        f"  to follow its log again: ray job logs --follow {submission}",
    )
