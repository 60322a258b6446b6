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

# Columns of one protocol's table: type and content. Types are those of pandas; object for lists.
SAMPLE_COLUMNS = {
    "protocol": ("str", "families or paper"),
    "family": ("str", "of the problem"),
    "problem": ("int64", "its number within family and split"),
    "run": ("int64", "number of the run on this problem"),
    "seed": ("int64", "of planner and sampler, the same for every arm of the run"),
    "arm": ("str", "name of the arm"),
    "group": ("str", "purpose of the arm"),
    "planner": ("str", "as OMPL names it; SampledRRTConnect is the project's own"),
    "sampler": ("str", "the learned sampler; empty for uniform samples"),
    "learned_share": ("float64", "share of learned samples among those drawn, while there are any"),
    "samples_asked": ("int64", "number requested from the sampler"),
    "samples_got": ("int64", "number that the sampler returned"),
    "epsilon_sigma": ("object", "increments of the encoder's standard deviation, in equal shares"),
    "min_confidence": ("float64", "threshold of the validity head"),
    "range_rad": ("float64", "of the planner, in OMPL's metric"),
    "stop_at_first": ("bool", "whether the search ended with its first solution"),
    "iteration_limit": ("int64", "states drawn after which the search ended"),
    "time_limit_s": ("float64", "wall time after which the search ended"),
    "solved": ("bool", "the path ends within 1e-6 rad of the goal and is free at ten times the resolution"),
    "reason": ("str", "why the search ended, in words"),
    "iterations": ("int64", "states drawn until the search ended"),
    "edge_checks": ("int64", "motions checked until the search ended"),
    "state_checks": ("int64", "states checked, within motions and alone"),
    "learned_drawn": ("int64", "states that came from the learned samples"),
    "uniform_drawn": ("int64", "states that were uniform"),
    "solve_s": ("float64", "wall time of the search, putting samples in order included"),
    "state_check_s": ("float64", "time of one state check on this problem, measured in a compiled loop"),
    "check_s": ("float64", "state_checks times state_check_s"),
    "plan_s": ("float64", "the rest of solve_s: everything but the checks"),
    "request_s": ("float64", "from the request for samples to their arrival; 0 for uniform ones"),
    "decode_s": ("float64", "of the request, reading the picture"),
    "encode_s": ("float64", "of the request, the latent"),
    "generate_s": ("float64", "of the request, drawing and scoring"),
    "server_s": ("float64", "of the request, all that the sampler reports"),
    "transport_s": ("float64", "of the request, the rest; 0 for a bundle in the planner's process"),
    "total_s": ("float64", "request_s and solve_s"),
    "length_rad": ("float64", "torus length of the path found last; empty without one"),
    "first_iterations": ("Int64", "iterations to the first solution; empty without one"),
    "first_edge_checks": ("Int64", "edge checks to the first solution"),
    "first_s": ("float64", "search time to the first solution"),
    "first_length_rad": ("float64", "torus length of the first solution"),
    "cost_iterations": ("object", "of an optimising search, one entry for each improvement: iterations"),
    "cost_edge_checks": ("object", "likewise: edge checks"),
    "cost_s": ("object", "likewise: search time"),
    "cost_length_rad": ("object", "likewise: torus length of the best path so far"),
    "novelty": ("float64", "of the picture, as the sampler reports it"),
    "bottleneck_rad": (
        "float64",
        "largest clearance at which start and goal stay connected; infinite becomes empty",
    ),
}
PLAN_COLUMNS = {
    "checked": ("bool", "whether a planner with exact checks went on from the paths"),
    "source": ("str", "where the problem comes from"),
    "family": ("str", "of the problem"),
    "problem": ("int64", "its number within family and split"),
    "pictures": ("int64", "number by which the scene is seen; 0 for arms that do not depend on them"),
    "run": ("int64", "number of the run on this problem"),
    "arm": ("str", "name of the arm"),
    "sampler": ("str", "the model that plans; empty for none"),
    "status": ("str", "solved; refused, without a path; timeout; or why a search with checks ended"),
    "solved": ("bool", "whether there is a path; with exact checks, one that is free"),
    "confidence": ("float64", "of the model that the whole path is free"),
    "clearance_m": (
        "float64",
        "least true clearance of the path, by spheres each 0.01 rad; 0 or less collides",
    ),
    "meshes_free": ("boolean", "whether the path is free by meshes; empty where these are not installed"),
    "unseen": ("float64", "share of the arm that no picture shows, mean along the path"),
    "length_rad": ("float64", "of the path, Euclidean"),
    "search_s": ("float64", "searching for paths without exact checks"),
    "score_s": ("float64", "of the model, scoring them"),
    "request_s": ("float64", "all until the paths were there, with the reading of the picture"),
    "as_is": ("boolean", "whether one of the paths was free without a search"),
    "state_checks": ("Int64", "exact state checks"),
    "edge_checks": ("Int64", "exact motion checks"),
    "iterations": ("Int64", "states drawn by RRT-Connect"),
    "solve_s": ("float64", "wall time of the search with exact checks"),
    "state_check_s": ("float64", "time of one state check by spheres on this problem"),
    "mesh_check_s": ("float64", "the same by convex meshes; empty where these are not installed"),
}
MANIFEST, RUNS = "manifest.json", "runs.jsonl"
SCHEMA = 2


def columns_of(protocol: Protocol) -> Mapping[str, tuple[str, str]]:
    """Types and contents of a protocol's columns."""
    return PLAN_COLUMNS if protocol is Protocol.PLANS else SAMPLE_COLUMNS


def key_of(row: Mapping[str, Any]) -> Key:
    """Family, problem, pictures, run and arm of a row."""
    return row["family"], row["problem"], row.get("pictures", 0), row["run"], row["arm"]


def frame_of(rows: Iterable[Row], protocol: Protocol) -> pd.DataFrame:
    """The table of rows, in the order of their keys.

    Raises:
        EvaluationError: a row has other columns than the protocol's.
    """
    columns, ordered = columns_of(protocol), sorted(rows, key=key_of)
    for row in ordered:
        if set(row) != set(columns):
            wrong = ", ".join(sorted(set(row) ^ set(columns)))
            raise EvaluationError("a run can not be read", expected="the columns of this release", got=wrong)
    frame = pd.DataFrame(ordered, columns=list(columns))
    return frame.astype({name: kind for name, (kind, _) in columns.items()})


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
            "setting": {name: value for name, value in asdict(setting).items() if name != "world"},
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
