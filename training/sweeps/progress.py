"""How far a job is, read from the folders of its trials."""

import json
from pathlib import Path

# Of a trial's rows only the last one counts; they are short.
_TAIL = 16_384


def stage_of(folder: Path) -> str:
    """The stage that a job's folder was written to last, and the step of each trial there; empty before it.

    Steps are those of the trials' reports to Tune: the first, and one a checkpoint.
    """
    found = sorted(folder.glob("*/*/result.json"), key=_written)
    if not found:
        return ""
    stage = found[-1].parent.parent
    steps = [_last_step(path) for path in sorted(stage.glob("*/result.json"))]
    shown = ", ".join("?" if step is None else str(step) for step in steps)
    return f"{stage.name}, step {shown}"


def _written(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _last_step(path: Path) -> int | None:
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - _TAIL))
            rows = file.read().splitlines()
        return int(json.loads(rows[-1])["step"])
    except (OSError, ValueError, KeyError, IndexError):
        # A row may be half written; the next look will find it whole.
        return None
