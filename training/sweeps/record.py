"""What a sweep keeps on disk: its plan, its run, and how every point ended; by that it goes on."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from cspace.errors import ConfigError
from cspace.files import write_json
from training.sweeps.grid import Point

PLAN, RESULTS = "sweep.json", "results"
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,47}")

# Numbers of the final table, and whether less is better.
MEASURES = {"precision": False, "coverage": False, "edr": True, "seconds": True}


@dataclass(frozen=True, slots=True)
class PointResult:
    """How a point ended.

    Args:
        state: finished, failed, or stopped before its end; but for finished ones they go on with the sweep.
        seconds: that its job took, over all attempts that this sweep saw to their end.
        metrics: by name; empty for a failed one.
        run_id: of its job in the tracking server; empty for one that failed before it had one.
        error: what failed; empty for a finished one.
    """

    state: Literal["finished", "failed", "stopped"]
    seconds: float
    metrics: Mapping[str, float]
    run_id: str = ""
    error: str = ""


@dataclass(frozen=True, slots=True)
class SweepRecord:
    """A sweep's folder.

    Args:
        name: of the sweep, and the beginning of its points' job ids.
        folder: holds the plan and a file for each result.
        run_id: of the sweep in the tracking server.
    """

    name: str
    folder: Path
    run_id: str

    @classmethod
    def load(
        cls, data_folder: Path, name: str, preset: str, overrides: Sequence[str]
    ) -> "SweepRecord | None":
        """The sweep of this name, or None where there is none yet.

        Raises:
            ConfigError: the name does not fit, or it stands for another preset or other settings.
        """
        if not _NAME.fullmatch(name):
            raise ConfigError(
                "the sweep's name does not fit", expected="a-z, 0-9 and -, 48 at most", got=repr(name)
            )
        path = sweep_folder(data_folder, name) / PLAN
        if not path.is_file():
            return None
        plan = json.loads(path.read_text(encoding="utf-8"))
        there, wanted = (plan["preset"], plan["overrides"]), (preset, list(overrides))
        if there != wanted:
            raise ConfigError(
                f"the sweep {name} stands for other settings",
                expected=f"--preset {there[0]} and {there[1]}",
                got=f"--preset {preset} and {list(overrides)}",
                remedy="give a new sweep a name of its own with --job; only the grid may change",
            )
        return cls(name, path.parent, str(plan["run_id"]))

    @classmethod
    def create(
        cls, data_folder: Path, name: str, preset: str, overrides: Sequence[str], run_id: str
    ) -> "SweepRecord":
        """A sweep that begins."""
        folder = sweep_folder(data_folder, name)
        (folder / RESULTS).mkdir(parents=True, exist_ok=True)
        plan = {"preset": preset, "overrides": list(overrides), "run_id": run_id}
        write_json(folder / PLAN, plan, indent=2)
        return cls(name, folder, run_id)

    def job_id(self, point: Point) -> str:
        """The id under which a point's job goes on."""
        return f"{self.name}-{point.key}"

    def result(self, point: Point) -> PointResult | None:
        """How a point ended; None where it has not."""
        path = self.folder / RESULTS / f"{point.key}.json"
        return (
            PointResult(**json.loads(path.read_text(encoding="utf-8"))["result"]) if path.is_file() else None
        )

    def keep(self, point: Point, result: PointResult) -> None:
        """Write down how a point ended."""
        content = {"settings": dict(point.settings), "result": asdict(result)}
        write_json(self.folder / RESULTS / f"{point.key}.json", content, indent=2)


def sweep_folder(data_folder: Path, name: str) -> Path:
    """Where a sweep keeps its plan and its results."""
    return data_folder / "sweeps" / name
