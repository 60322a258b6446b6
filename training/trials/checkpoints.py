"""Where a trial keeps its checkpoints: a folder a step, complete or not there at all.

They lie in the job's folder under the trial's name, so that whoever runs the trial next, after a fault of its
worker, of the driver or of the whole cluster, finds the last of them without being told.
"""

import re
from contextlib import AbstractContextManager
from pathlib import Path

from cspace.errors import JobError
from cspace.files import HALF_SUFFIX, discard, holding
from training.models.checkpoint import Progress, save_checkpoint
from training.models.modules import TrialModule

_STEP = re.compile(r"step-(\d{9})")


class TrialFolder:
    """The checkpoints of one trial.

    Args:
        folder: of the trial, on storage that all nodes share; made by the first checkpoint.
        keep: how many of the last ones stay.
    """

    def __init__(self, folder: Path, keep: int = 1) -> None:
        self.folder, self.keep = folder, keep

    def alone(self, patience_s: float = 120.0) -> AbstractContextManager[None]:
        """Hold the trial: a worker whose driver was killed may still train it for a moment.

        Raises:
            JobError: another process holds it, and goes on to.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        busy = JobError(
            f"the trial {self.folder.name} is run by another process",
            expected=f"its end within {patience_s:.0f} s",
            remedy="end that process",
        )
        return holding(self.folder / "lock", busy, patience_s)

    def checkpoints(self) -> tuple[Path, ...]:
        """Those that are complete, oldest first."""
        found = self.folder.glob("step-*") if self.folder.is_dir() else ()
        return tuple(sorted(path for path in found if _STEP.fullmatch(path.name)))

    def latest(self) -> Path | None:
        """The last one; None before the first."""
        return (self.checkpoints() or (None,))[-1]

    def save(self, module: TrialModule, progress: Progress) -> Path:
        """Write a checkpoint beside, rename it into place, and let the oldest go.

        Raises:
            OSError: the disk is full, or cannot be written.
        """
        saved = save_checkpoint(self.folder / f"step-{progress.step:09d}", module, progress)
        for old in self.checkpoints()[: -self.keep]:
            discard(old)
        # What a process that was killed had not finished; the job may be writing the trial's record.
        for half in self.folder.glob(f"*step-*{HALF_SUFFIX}"):
            discard(half)
        return saved
