"""The job of a benchmark: run what is missing, write table, report and figures, log them."""

import json
import multiprocessing
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import version
from itertools import product
from pathlib import Path
from threading import Thread
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from cspace.errors import ConfigError, JobError, StorageError
from cspace.files import make_output_folder, write_json
from services.evaluator.benchmark.figures import figures
from services.evaluator.benchmark.report import Results
from services.evaluator.benchmark.runs import COLUMNS, Row, Worker
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.variants import Key, Protocol, Setting, Unit, Variant
from services.evaluator.cluster import on_cluster, spread
from services.names import EXPERIMENT, NOTE, TAG_STAGE
from services.progress import Progress
from services.registry.entities import ID
from services.registry.tracking import Tracking

Show = Callable[[str], None]
Execute = Callable[[Sequence[Unit], Setting, Sequence[SourceSpec]], Iterator[list[Row]]]
Shared = tuple[Setting, tuple[SourceSpec, ...]]
PARQUET, REPORT, RUNS, MANIFEST, FIGURES = (
    "runs.parquet", "report.md", "runs.jsonl", "manifest.json", "figures",
)  # fmt: skip
STAGE = "planning-benchmark"
# Each process computes on one core; the thread pools of numeric libraries would compete for the others.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Request:
    """What a benchmark runs: ``problems`` of each family, ``repeats`` of each where checks are exact.

    ``pictures`` is (0,) where depth pictures do not matter; ``folder`` holds problems that do not ship.
    """

    out: Path
    setting: Setting
    problems: Mapping[str, int]
    repeats: int
    variants: tuple[Variant, ...]
    specs: tuple[SourceSpec, ...]
    pictures: tuple[int, ...] = (0,)
    folder: Path | None = None

    def units(self) -> Iterator[Unit]:
        """Everything that is run."""
        setting = self.setting
        for family, count in self.problems.items():
            if setting.protocol is Protocol.PLANS:
                for index, seen in product(range(count), (0, *self.pictures)):
                    own = [one for one in self.variants if one.pictured == (seen > 0)]
                    todo = [(one, run) for one in own for run in range(self.repeats if one.checked else 1)]
                    yield Unit(family, index, tuple(todo), seen, self.folder)
            else:
                for index, run in product(range(count), range(self.repeats)):
                    yield Unit(family, index, tuple((one, run) for one in self.variants))


def run_benchmark(
    request: Request, execute: Execute, show: Show, tracking: Tracking | None = None
) -> Results:
    """Run what is missing, report on the whole request, and log it where there is a tracking server."""
    store = RunStore(request)
    units = list(request.units())
    done = {_key(row) for row in store.rows()}
    work = [left for unit in units if (left := unit.without(done)).todo]
    show(f"{len(request.variants)} variants; {len(work)} units to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    wanted = {key for unit in units for key in unit.run_keys()}
    rows = sorted((row for row in store.rows() if _key(row) in wanted), key=_key)
    runs = pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)
    results = Results(runs, request.setting, request.variants, request.pictures, store.manifest)
    plots = dict(figures(results))
    _write(results, request.out, plots)
    if tracking is not None:
        show(f"logged as run {_log(tracking, results, request, plots)}")
    return results


def _write(results: Results, out: Path, plots: Mapping[str, Figure]) -> None:
    results.runs.to_parquet(out / PARQUET, index=False)
    (out / FIGURES).mkdir(exist_ok=True)
    for name, figure in plots.items():
        figure.savefig(out / FIGURES / f"{name}.png")
    (out / REPORT).write_text(results.markdown([f"{FIGURES}/{name}.png" for name in plots]), "utf-8")


def _log(tracking: Tracking, results: Results, request: Request, plots: Mapping[str, Figure]) -> str:
    """Settings, metrics and files as a tracking run; its id."""
    setting, out = request.setting, request.out
    what = setting.split if setting.protocol is Protocol.PLANS else ", ".join(request.problems)
    name = f"planning, {setting.protocol}, {what}, seed {setting.seed}, {ID}"
    with tracking.start(EXPERIMENT, name, tags={"protocol": setting.protocol.value, TAG_STAGE: STAGE}) as run:
        samplers = {spec.name: spec.digest for spec in request.specs}
        run.params({"setting": asdict(setting), "samplers": samplers})
        run.metrics(results.metrics(), 0)
        run.table(results.columns(), "variants")
        run.tags({NOTE: results.note()})
        for part in (MANIFEST, PARQUET, REPORT):
            run.artifact(out / part)
        for name, figure in plots.items():
            run.figure(figure, name)
        run.flush()
        return run.run_id


def _key(row: Mapping[str, Any]) -> Key:
    return row["family"], row["problem"], row["pictures"], row["run"], row["variant"]


class RunStore:
    """Runs as a line of JSON each beside a manifest; one that was stopped goes on."""

    def __init__(self, request: Request) -> None:
        self._path, manifest = request.out / RUNS, request.out / MANIFEST
        described: dict[str, Any] = {
            "setting": asdict(request.setting) | {"world": request.setting.world.to_dict()},
            "variants": {one.name: asdict(one) for one in request.variants},
            "samplers": {spec.name: spec.described for spec in request.specs},
        }
        # As JSON has it: lists for tuples.
        self.manifest = json.loads(json.dumps(described))
        try:
            make_output_folder(request.out)
            old = json.loads(manifest.read_text("utf-8")) if manifest.is_file() else {}
            self._join(old)
            write_json(manifest, self.manifest, indent=1)
            if self._path.is_file():
                # A killed process leaves half a line.
                os.truncate(self._path, self._path.read_bytes().rfind(b"\n") + 1)
        except OSError as error:
            raise StorageError(f"the folder {request.out} can not be used", got=str(error)) from error

    def _join(self, old: dict[str, Any]) -> None:
        new = self.manifest
        for part in ("setting", "variants", "samplers"):
            before = old.get(part, {})
            for name, value in new[part].items():
                if before.get(name, value) != value:
                    raise ConfigError(
                        f"the folder holds runs of another setting: {part}, {name}",
                        expected=json.dumps(before[name]),
                        got=json.dumps(value),
                        remedy="name another folder with --out",
                    )
            new[part] = before | new[part]
        # Times depend on the machine; each command that runs here adds its own.
        packages = {name: version(name) for name in ("ompl", "numpy", "numba", "onnxruntime")}
        session = {
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "machine": platform.platform(),
            "cores": os.cpu_count(),
            "packages": packages,
        }
        new["sessions"] = [*old.get("sessions", []), session]

    def rows(self) -> list[Row]:
        """All runs in the order in which they came."""
        lines = self._path.read_text("utf-8").splitlines() if self._path.is_file() else []
        return [json.loads(line) for line in lines]

    def append(self, rows: Iterable[Row]) -> None:
        """Keep the runs of a unit."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))


_worker_of = lru_cache(maxsize=1)(Worker)


def run_unit(unit: Unit, shared: Shared) -> list[Row]:
    """One unit in this process, whose models stay open between units."""
    return _worker_of(*shared).run(unit)


def executor(environment: Mapping[str, str], count: int) -> Execute:
    """Over the Ray cluster where RAY_ADDRESS names one, else over so many processes of this machine."""
    return run_on_ray if on_cluster(environment) else processes(count)


def run_on_ray(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Row]]:
    """Runs as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again."""
    return spread(run_unit, work, (setting, tuple(specs)), "benchmark")


def processes(count: int) -> Execute:
    """Units over so many spawned processes of this machine."""

    def run(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Row]]:
        for name in _ONE_THREAD:
            os.environ.setdefault(name, "1")
        shared = (setting, tuple(specs))
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(count, context, _begin, (shared,))
        try:
            for done in as_completed([pool.submit(_run, unit) for unit in work]):
                yield done.result()
        except BrokenProcessPool as error:
            raise JobError(
                "a process of the benchmark ended",
                got=str(error),
                remedy="give the command again: it goes on from the runs that it has",
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)

    return run


_shared: list[Shared] = []


def _begin(shared: Shared) -> None:
    end_with_parent()
    _shared[:] = [shared]


def _run(unit: Unit) -> list[Row]:
    return run_unit(unit, _shared[0])


def end_with_parent() -> None:
    """In a process of a pool: ends when the process that made it has ended, in whatever way."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def follow() -> None:
        parent.join()
        os._exit(1)

    Thread(target=follow, name="parent", daemon=True).start()
