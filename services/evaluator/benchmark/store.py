"""Runs of a benchmark: records in JSON lines beside a manifest, so that a stopped benchmark resumes."""

import json
import math
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Generic, Self, TypeVar, cast, get_type_hints

import pyarrow as pa
import pyarrow.parquet as pq

from cspace.errors import ConfigError, EvaluationError, StorageError
from cspace.files import make_output_folder, write_json
from cspace.worlds import default_world
from services.evaluator.benchmark.arms import Arm, Setting
from services.evaluator.benchmark.sources import SourceSpec


class Record:
    """A flat dataclass, annotated with what each column holds."""

    __slots__ = ()

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from all others."""
        raise NotImplementedError

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self), allow_nan=False)  # type: ignore[call-overload]

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Read one line.

        Raises:
            EvaluationError: it holds no run.
        """
        try:
            found: dict[str, Any] = json.loads(line)
            lists = {name: tuple(value) for name, value in found.items() if isinstance(value, list)}
            return cls(**{**found, **lists})
        except (ValueError, TypeError) as error:
            raise EvaluationError(
                "a line of the runs can not be read", expected="the columns of this release", got=line[:80]
            ) from error


def descriptions(kind: type[Record]) -> dict[str, str]:
    """What each column of a kind of records holds."""
    return {name: hint.__metadata__[0] for name, hint in get_type_hints(kind, include_extras=True).items()}


@dataclass(frozen=True, slots=True)
class Run(Record):
    """One run, each column with what it holds."""

    protocol: Annotated[str, "families or paper"]
    family: Annotated[str, "of the problem"]
    problem: Annotated[int, "its number within family and split"]
    run: Annotated[int, "number of the run on this problem"]
    seed: Annotated[int, "of planner and sampler, the same for every arm of the run"]
    arm: Annotated[str, "name of the way to solve"]
    group: Annotated[str, "what the arm is there for"]
    planner: Annotated[str, "as OMPL names it; SampledRRTConnect is the project's own"]
    sampler: Annotated[str | None, "the learned sampler; empty for uniform samples"]
    learned_share: Annotated[float, "of learned samples among those drawn, while there are any"]
    samples_asked: Annotated[int, "of the sampler"]
    samples_got: Annotated[int, "from the sampler"]
    epsilon_sigma: Annotated[
        tuple[float, ...], "what the encoder's standard deviation was raised by, in equal shares"
    ]
    min_confidence: Annotated[float, "what the validity head had to score"]
    range_rad: Annotated[float, "of the planner, in OMPL's metric"]
    stop_at_first: Annotated[bool, "whether the search ended with its first solution"]
    iteration_limit: Annotated[int, "states drawn after which the search ended"]
    time_limit_s: Annotated[float, "wall time after which the search ended"]
    solved: Annotated[
        bool, "the path ends within 1e-6 rad of the goal and is free at ten times the resolution"
    ]
    reason: Annotated[str, "why the search ended, in words"]
    iterations: Annotated[int, "states drawn until the search ended"]
    edge_checks: Annotated[int, "motions checked until the search ended"]
    state_checks: Annotated[int, "states looked at, within motions and alone"]
    learned_drawn: Annotated[int, "states that came from the learned samples"]
    uniform_drawn: Annotated[int, "states that were uniform"]
    solve_s: Annotated[float, "wall time of the search, putting samples in order included"]
    state_check_s: Annotated[
        float, "what a look at a state takes on this problem, measured in a loop of the kernel alone"
    ]
    check_s: Annotated[float, "state_checks times state_check_s"]
    plan_s: Annotated[float, "the rest of solve_s: everything but the checks"]
    request_s: Annotated[float, "from asking for samples to having them; 0 for uniform ones"]
    decode_s: Annotated[float, "of the request, the sampler's reading of the picture"]
    encode_s: Annotated[float, "of the request, the latent"]
    generate_s: Annotated[float, "of the request, drawing and scoring"]
    server_s: Annotated[float, "of the request, all that the sampler tells of"]
    transport_s: Annotated[float, "of the request, the rest; 0 for a bundle in the planner's process"]
    total_s: Annotated[float, "request_s and solve_s"]
    length_rad: Annotated[float | None, "torus length of the path found last; empty without one"]
    first_iterations: Annotated[int | None, "iterations to the first solution; empty without one"]
    first_edge_checks: Annotated[int | None, "edge checks to the first solution"]
    first_s: Annotated[float | None, "search time to the first solution"]
    first_length_rad: Annotated[float | None, "torus length of the first solution"]
    cost_iterations: Annotated[
        tuple[int, ...], "of an optimising search, one entry an improvement: iterations"
    ]
    cost_edge_checks: Annotated[tuple[int, ...], "likewise: edge checks"]
    cost_s: Annotated[tuple[float, ...], "likewise: search time"]
    cost_length_rad: Annotated[tuple[float, ...], "likewise: torus length of the best path so far"]
    novelty: Annotated[float | None, "of the picture, as the sampler tells it"]
    bottleneck_rad: Annotated[
        float | None, "largest clearance at which start and goal stay connected; infinite becomes empty"
    ]

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Family, problem, run and arm."""
        return self.family, self.problem, self.run, self.arm


DESCRIPTIONS = descriptions(Run)
"""What each column of ``runs.parquet`` holds."""


def finite(value: float) -> float | None:
    """The value, None where there is none: JSON knows neither infinity nor nan."""
    return float(value) if math.isfinite(value) else None


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


_KINDS: dict[object, pa.DataType] = {
    str: pa.string(),
    str | None: pa.string(),
    int: pa.int64(),
    int | None: pa.int64(),
    bool: pa.bool_(),
    float: pa.float64(),
    float | None: pa.float64(),
    bool | None: pa.bool_(),
    tuple[float, ...]: pa.list_(pa.float64()),
    tuple[int, ...]: pa.list_(pa.int64()),
}


def write_parquet(runs: Sequence[Record], path: Path) -> None:
    """Write the table; what a column holds travels with it as metadata of its field.

    Args:
        runs: of one kind, one or more.
        path: of the file.

    Raises:
        StorageError: the file can not be written.
    """
    kind, rows = type(runs[0]), [asdict(cast("Any", run)) for run in runs]
    told = descriptions(kind)
    schema = pa.schema(
        pa.field(name, _KINDS[hint], metadata={"what": told[name]})
        for name, hint in get_type_hints(kind).items()
    )
    table = pa.Table.from_pylist(rows, schema=schema)
    try:
        pq.write_table(table, path)
    except OSError as error:
        raise StorageError(f"{path} can not be written", got=str(error)) from error
