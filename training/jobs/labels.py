"""What runs of jobs are called, the tags by which they are found, the settings by which they are compared."""

import json
import tempfile
from pathlib import Path

from cspace.world import World
from services.names import robot_name
from services.registry.tracking.experiment import TAG_JOB, TAG_PRESET, TAG_STAGE, TAG_WORLD
from services.registry.tracking.parameters import flatten
from services.registry.tracking.port import RunLog
from training.config.job import JobConfig

LONGEST = 100
"""Characters of a parameter."""


def job_label(config: JobConfig, name: str | None) -> str:
    """A job in a run's name: its own name, or its preset's, and its seed."""
    return f"{name or config.preset}, seed {config.seed}"


def shown_tags(config: JobConfig, name: str | None, stage: str) -> dict[str, str]:
    """Tags of a job's run, or of a trial's.

    Args:
        config: of the job.
        name: of the job; None for one that only its run names.
        stage: what the run is of: ``cluster-train``, ``local``.
    """
    return {TAG_STAGE: stage, TAG_JOB: name or "", TAG_PRESET: config.preset}


def world_tag(world: World, given: str | None) -> dict[str, str]:
    """The tag of the world and the robot that a job is for.

    Args:
        world: of its data.
        given: the robot's name, as :func:`services.names.robot_name` takes it.
    """
    return {TAG_WORLD: f"{world.kind}, {robot_name(world, given)}"}


def log_configuration(run: RunLog, config: JobConfig) -> None:
    """The settings as parameters, one each, and the whole of them as ``configuration.json``.

    Those that are longer than a column of a table are left to the file, and those that are not set.
    """
    values = config.to_dict()
    short = {key: text for key, text in flatten(values).items() if text != "None" and len(text) <= LONGEST}
    run.params(short)
    with tempfile.TemporaryDirectory(prefix="cspace-configuration-") as folder:
        path = Path(folder) / "configuration.json"
        path.write_text(json.dumps(values, indent=1), encoding="utf-8")
        run.artifact(path)
