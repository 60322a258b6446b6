"""What a trial is asked for, and where it works."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cspace.splits import derived_seed
from training.jobs.job import Job
from training.trials.checkpoints import TrialFolder


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """A trial; it travels to its worker through the object store.

    Args:
        folder: of its checkpoints and its record, ``<job>/<stage>/<name>`` on storage that all nodes share.
        run_id: of its tracking run.
        seed: of initialisation and of every draw.
        cluster: whose configurations it learns; None for all.
        start: checkpoint of an earlier job's trial whose weights it starts from; None to start from nothing.
        job: whose it is, for the lines of its log.
    """

    folder: Path
    run_id: str = ""
    seed: int = 0
    cluster: int | None = None
    start: Path | None = None
    job: str = ""

    @classmethod
    def of(cls, job: Job[Any], stage: str, name: str, cluster: int | None = None) -> "TrialRequest":
        """A trial of a job, with the run that it has there and a seed of its own.

        Raises:
            ConfigError: the folder of the job that it is to start from is gone.
        """
        seed = derived_seed(job.config.seed, stage, name)
        earlier = job.start_folder
        start = None if earlier is None else TrialFolder(earlier / stage / name).latest()
        label = f"{job.name or job.run.run_id[:8]}, seed {job.config.seed}"
        return cls(job.folder / stage / name, job.child(name), seed, cluster, start, label)

    @property
    def name(self) -> str:
        """The trial's name in its stage."""
        return self.folder.name

    @property
    def stage(self) -> Path:
        """The folder of the stage's trials."""
        return self.folder.parent

    @property
    def spool(self) -> Path:
        """Where metrics wait that could not be sent, for all trials of the job."""
        return self.stage.parent / "spool"

    @property
    def stop(self) -> Path:
        """A file that is there while the job is being stopped."""
        return stop_file(self.stage.parent)


def stop_file(job: Path) -> Path:
    """The file by which a job's trials are told to end."""
    return job / "stop"
