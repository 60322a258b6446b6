"""Where jobs lie in the data folder."""

import json
from pathlib import Path

from training.jobs.environment import Environment

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
