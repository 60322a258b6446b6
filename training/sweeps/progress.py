"""How far a job is, read from the folders of its trials."""

from pathlib import Path

from training.trials.checkpoints import TrialFolder


def stage_of(folder: Path) -> str:
    """The stage of a job that began last, and the step of each trial's last checkpoint; empty before any."""
    held = {path: path.stat().st_mtime for path in folder.glob("*/*/lock")}
    if not held:
        return ""
    stage = max(held, key=held.__getitem__).parent.parent
    trials = [TrialFolder(path.parent).latest() for path in sorted(stage.glob("*/lock"))]
    steps = ["0" if last is None else str(int(last.name.rpartition("-")[2])) for last in trials]
    return f"{stage.name}, step {', '.join(steps)}"
