"""The runs of a benchmark: a line of JSON each beside a manifest, so that a stopped benchmark goes on."""

import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from cspace.errors import ConfigError, EvaluationError, StorageError
from cspace.files import make_output_folder, write_json
from services.evaluator.benchmark.arms import Key, Protocol, Setting
from services.evaluator.benchmark.sources import SourceSpec

Row = dict[str, Any]

# Columns of a protocol's table with their pandas types (object: lists); docs/benchmark.md describes them.
SAMPLE_COLUMNS = {
    "protocol": "str", "family": "str", "problem": "int64", "run": "int64", "seed": "int64", "arm": "str",
    "group": "str", "planner": "str", "sampler": "str", "learned_share": "float64",
    "samples_asked": "int64", "samples_got": "int64", "epsilon_sigma": "object",
    "min_confidence": "float64", "range_rad": "float64", "stop_at_first": "bool",
    "iteration_limit": "int64", "time_limit_s": "float64", "solved": "bool", "reason": "str",
    "iterations": "int64", "edge_checks": "int64", "state_checks": "int64", "learned_drawn": "int64",
    "uniform_drawn": "int64", "solve_s": "float64", "state_check_s": "float64", "check_s": "float64",
    "plan_s": "float64", "request_s": "float64", "decode_s": "float64", "encode_s": "float64",
    "generate_s": "float64", "server_s": "float64", "transport_s": "float64", "total_s": "float64",
    "length_rad": "float64", "first_iterations": "Int64", "first_edge_checks": "Int64",
    "first_s": "float64", "first_length_rad": "float64", "cost_iterations": "object",
    "cost_edge_checks": "object", "cost_s": "object", "cost_length_rad": "object", "novelty": "float64",
    "bottleneck_rad": "float64",
}  # fmt: skip
PLAN_COLUMNS = {
    "checked": "bool", "source": "str", "family": "str", "problem": "int64", "pictures": "int64",
    "run": "int64", "arm": "str", "sampler": "str", "status": "str", "solved": "bool",
    "confidence": "float64", "clearance_m": "float64", "meshes_free": "boolean", "unseen": "float64",
    "length_rad": "float64", "search_s": "float64", "score_s": "float64", "request_s": "float64",
    "as_is": "boolean", "state_checks": "Int64", "edge_checks": "Int64", "iterations": "Int64",
    "solve_s": "float64", "state_check_s": "float64", "mesh_check_s": "float64",
}  # fmt: skip
MANIFEST, RUNS = "manifest.json", "runs.jsonl"
SCHEMA = 2


def key_of(row: Mapping[str, Any]) -> Key:
    """Family, problem, pictures, run and arm of a row."""
    return row["family"], row["problem"], row.get("pictures", 0), row["run"], row["arm"]


def frame_of(rows: Iterable[Row], protocol: Protocol) -> pd.DataFrame:
    """The table of rows, in the order of their keys.

    Raises:
        EvaluationError: a row has other columns than the protocol's.
    """
    columns = PLAN_COLUMNS if protocol is Protocol.PLANS else SAMPLE_COLUMNS
    ordered = sorted(rows, key=key_of)
    for row in ordered:
        if wrong := set(row) ^ set(columns):
            raise EvaluationError(
                "a run can not be read", expected="the columns of this release", got=", ".join(sorted(wrong))
            )
    return pd.DataFrame(ordered, columns=list(columns)).astype(columns)


class RunStore:
    """Appends runs to a folder and reads them back; one process writes at a time.

    Starts a folder, or goes on with one of the same setting; further arms and samplers may be added to it.

    Args:
        folder: of runs and manifest.
        setting: of the runs.
        arms: dataclasses with a ``name``.
        specs: the models.

    Raises:
        ConfigError: the folder holds runs of another setting, or other arms or samplers of the same names.
        StorageError: the folder can not be written.
    """

    def __init__(
        self, folder: Path, setting: Setting, arms: Iterable[Any], specs: Iterable[SourceSpec]
    ) -> None:
        self.folder, self._path, self._protocol = folder, folder / RUNS, setting.protocol
        described: dict[str, Any] = {
            "schema": SCHEMA,
            # What is off is left out, so that folders without it go on.
            "setting": {
                name: value
                for name, value in asdict(setting).items()
                if name != "world" and value is not False
            },
            "world": setting.world.to_dict(),
            "arms": {arm.name: asdict(arm) for arm in arms},
            "samplers": {spec.name: spec.described for spec in specs},
        }
        # As JSON has it: lists for tuples.
        described, path = json.loads(json.dumps(described)), folder / MANIFEST
        try:
            make_output_folder(folder)
            old = json.loads(path.read_text("utf-8")) if path.is_file() else None
            self.manifest = described if old is None else _merged(old, described)
            # Times depend on the machine; each command that runs here adds its own.
            self.manifest["sessions"] = [*self.manifest.get("sessions", []), _session()]
            write_json(path, self.manifest, indent=1)
            self._drop_partial_line()
        except OSError as error:
            raise StorageError(f"the folder {folder} can not be used", got=str(error)) from error

    def rows(self) -> list[Row]:
        """All runs in the order in which they came.

        Raises:
            EvaluationError: a line can not be read.
        """
        if not self._path.is_file():
            return []
        try:
            return [json.loads(line) for line in self._path.read_text("utf-8").splitlines()]
        except ValueError as error:
            raise EvaluationError(f"{self._path} can not be read", got=str(error)) from error

    def keys(self) -> set[Key]:
        """The keys of the runs that there are."""
        return {key_of(row) for row in self.rows()}

    def frame(self, keys: Iterable[Key]) -> pd.DataFrame:
        """The runs of some keys as a table.

        Raises:
            EvaluationError: a line can not be read.
        """
        wanted = set(keys)
        return frame_of((row for row in self.rows() if key_of(row) in wanted), self._protocol)

    def append(self, rows: Sequence[Row]) -> None:
        """Keep the runs of a unit.

        Raises:
            StorageError: they can not be written.
        """
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))
        except OSError as error:
            raise StorageError("the runs can not be kept", got=str(error)) from error

    def _drop_partial_line(self) -> None:
        """Drop what a killed process left of a last line."""
        if self._path.is_file():
            content = self._path.read_bytes()
            os.truncate(self._path, content.rfind(b"\n") + 1)


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    pairs = [(part, old.get(part), new[part], "") for part in ("schema", "setting", "world")]
    pairs += [
        (f"{part[:-1]} named {name}", old.get(part, {}).get(name, value), value, "give it another name, or ")
        for part in ("arms", "samplers")
        for name, value in new[part].items()
    ]
    for what, there, requested, instead in pairs:
        if there != requested:
            raise ConfigError(
                f"the folder holds runs of another {what}",
                expected=json.dumps(there),
                got=json.dumps(requested),
                remedy=f"{instead}name another folder with --out",
            )
    joined = {part: old[part] | new[part] for part in ("arms", "samplers")}
    return {**new, "sessions": old.get("sessions", []), **joined}


def _session() -> dict[str, Any]:
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in ("ompl", "numpy", "numba", "onnxruntime")},
        "cluster": os.environ.get("RAY_ADDRESS") or None,
    }
