"""The runs of a benchmark in a folder: JSON lines beside a manifest, so that a stopped benchmark goes on."""

import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

from cspace.errors import ConfigError, EvaluationError, StorageError
from cspace.files import make_output_folder, write_json
from cspace.worlds import default_world
from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.runs.run import Record, Run
from services.evaluator.benchmark.runs.setting import Setting
from services.evaluator.benchmark.runs.sources import SourceSpec

MANIFEST, RUNS = "manifest.json", "runs.jsonl"
SCHEMA = 1


Kept = TypeVar("Kept", bound=Record)


class RunStore(Generic[Kept]):
    """Appends runs and reads them back. Make one with :meth:`begin`; one process writes at a time."""

    def __init__(self, folder: Path, kind: type[Kept]) -> None:
        self.folder = folder
        self._path, self._kind = folder / RUNS, kind

    @staticmethod
    def open(
        folder: Path, setting: Setting, arms: Iterable[Arm], specs: Iterable[SourceSpec]
    ) -> "RunStore[Run]":
        """The store of the runs of planners with samples; see :meth:`begin`."""
        return RunStore.begin(folder, Run, setting, arms, specs)

    @classmethod
    def begin(
        cls, folder: Path, kind: type[Kept], setting: Any, arms: Iterable[Any], specs: Iterable[SourceSpec]
    ) -> "RunStore[Kept]":
        """Start a folder, or go on with one of the same setting; further arms may be added to it.

        Args:
            folder: of runs and manifest.
            kind: of the records.
            setting: a dataclass with a ``world``.
            arms: dataclasses with a ``name``.
            specs: the models.

        Raises:
            ConfigError: the folder holds runs of another setting, or of arms or samplers of the same names
                that are others.
            StorageError: the folder can not be written.
        """
        told: dict[str, Any] = {
            "schema": SCHEMA,
            # The world stands by itself, for folders that are older than worlds tell none.
            "setting": {name: value for name, value in asdict(setting).items() if name != "world"},
            "world": setting.world.to_dict(),
            "arms": {arm.name: asdict(arm) for arm in arms},
            "samplers": {spec.name: spec.described for spec in specs},
        }
        # As JSON has it: lists for tuples.
        told = json.loads(json.dumps(told))
        path = folder / MANIFEST
        try:
            make_output_folder(folder)
            merged = _merged(json.loads(path.read_text("utf-8")), told) if path.is_file() else told
            # What times depend on, once for every command that ran here.
            merged["sessions"] = [*merged.get("sessions", []), _session()]
            write_json(path, merged, indent=1)
            store = cls(folder, kind)
            store._mend()
        except OSError as error:
            raise StorageError(f"the folder {folder} can not be used", got=str(error)) from error
        return store

    def runs(self) -> list[Kept]:
        """All runs, in a fixed order whatever order they came in.

        Raises:
            EvaluationError: a line can not be read.
        """
        if not self._path.is_file():
            return []
        lines = self._path.read_text("utf-8").splitlines()
        return sorted((self._kind.from_json(line) for line in lines), key=lambda run: run.key)

    def done(self) -> set[Any]:
        """The keys of the runs that there are."""
        return {run.key for run in self.runs()}

    def append(self, runs: Sequence[Kept]) -> None:
        """Keep the runs of a unit for good.

        Raises:
            StorageError: they can not be written.
        """
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write("".join(run.to_json() + "\n" for run in runs))
        except OSError as error:
            raise StorageError("the runs can not be kept", got=str(error)) from error

    def manifest(self) -> dict[str, Any]:
        """What the folder is about."""
        found: dict[str, Any] = json.loads((self.folder / MANIFEST).read_text("utf-8"))
        return found

    def _mend(self) -> None:
        """Drop what a killed process left of a last line."""
        if not self._path.is_file():
            return
        content = self._path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            with self._path.open("r+b") as file:
                file.truncate(whole)


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    old = {"world": default_world().to_dict(), **old}
    for part in ("schema", "setting", "world"):
        if old.get(part) != new[part]:
            raise ConfigError(
                f"the folder holds runs of another {part}",
                expected=json.dumps(old.get(part)),
                got=json.dumps(new[part]),
                remedy="name another folder with --out",
            )
    merged = {**new, "sessions": old.get("sessions", [])}
    for part in ("arms", "samplers"):
        for name, value in new[part].items():
            if old[part].get(name, value) != value:
                raise ConfigError(
                    f"the folder holds runs of another {part[:-1]} named {name}",
                    expected=json.dumps(old[part][name]),
                    got=json.dumps(value),
                    remedy="give it another name, or name another folder with --out",
                )
        merged[part] = {**old[part], **new[part]}
    return merged


def _session() -> dict[str, Any]:
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in ("ompl", "numpy", "numba", "onnxruntime")},
        "cluster": os.environ.get("RAY_ADDRESS") or None,
    }


def complete(runs: Iterable[Run]) -> list[Run]:
    """Of every family the runs of those problems that all of its arms have run, so that arms are paired.

    Raises:
        EvaluationError: there are no runs.
    """
    kept: list[Run] = []
    by_family: dict[str, list[Run]] = {}
    for run in runs:
        by_family.setdefault(run.family, []).append(run)
    for mine in by_family.values():
        held: dict[str, set[tuple[int, int]]] = {}
        for run in mine:
            held.setdefault(run.arm, set()).add((run.problem, run.run))
        shared = set.intersection(*held.values())
        kept += [run for run in mine if (run.problem, run.run) in shared]
    if not kept:
        raise EvaluationError("no problem was run by all arms", expected="one or more", got="none")
    return kept
