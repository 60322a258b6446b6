"""What a run could not send, on disk until it can: metrics, and how the run ended.

One file a run, a JSON object a line, each batch written in one piece. A process that is killed as it writes
leaves a line without its end, which is dropped: a checkpoint is written after the batches before it, so that
such a batch is logged again.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from services.registry.tracking.metric_buffer import MetricPoint
from services.registry.tracking.port import RunStatus


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended.

    Args:
        status: of the run.
        time_ms: when, milliseconds since 1970-01-01 UTC.
    """

    status: RunStatus
    time_ms: int


@dataclass(frozen=True, slots=True)
class Unsent:
    """What waits for a run.

    Args:
        points: metrics in the order in which they were logged.
        ending: None for a run that goes on.
    """

    points: tuple[MetricPoint, ...]
    ending: Ending | None


class Spool:
    """The file of one run.

    Args:
        folder: of all runs' files, made by the first that has to wait.
        run_id: of the run.
    """

    def __init__(self, folder: Path, run_id: str) -> None:
        self._path = folder / f"{Path(run_id).name}.jsonl"

    def add(self, points: Sequence[MetricPoint]) -> None:
        """Keep metrics."""
        self._write([asdict(point) for point in points])

    def end(self, ending: Ending) -> None:
        """Keep how the run ended."""
        self._write([{"ending": asdict(ending)}])

    def read(self) -> Unsent:
        """Everything that waits."""
        points: list[MetricPoint] = []
        ending: Ending | None = None
        if not self._path.exists():
            return Unsent((), None)
        for line in self._path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except ValueError:
                continue
            if "ending" in row:
                ending = Ending(**row["ending"])
            else:
                # A run that was ended and goes on has not ended.
                points, ending = [*points, MetricPoint(**row)], None
        return Unsent(tuple(points), ending)

    def clear(self) -> None:
        """Everything was delivered."""
        self._path.unlink(missing_ok=True)

    def __bool__(self) -> bool:
        return self._path.exists()

    def _write(self, rows: Sequence[dict[str, object]]) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        text = "".join(json.dumps(row) + "\n" for row in rows)
        with self._path.open("a", encoding="utf-8") as file:
            # A line that a killed process left without its end must not swallow the next one.
            file.write(text if file.tell() == 0 else "\n" + text)
            file.flush()
            os.fsync(file.fileno())


def spooled_runs(folder: Path) -> tuple[str, ...]:
    """Ids of the runs for which something waits."""
    return tuple(sorted(path.stem for path in folder.glob("*.jsonl"))) if folder.is_dir() else ()
