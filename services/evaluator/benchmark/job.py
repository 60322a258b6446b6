"""The job of a benchmark: run what is missing, write table, report and figures, log them."""

import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import cache, cached_property, lru_cache
from itertools import product
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.errors import ConfigError, StorageError
from cspace.files import make_output_folder, write_json
from cspace.plan import load_kernels
from cspace.planning.paths import length_rad, spaced
from cspace.planning.search import find_paths
from cspace.query import DEFAULT_PATHS, SampleQuery
from cspace.simulator import Problem, UnseenPolicy
from cspace.worlds import checker_of, partly_seen, picture_file_of
from services.commands import Progress
from services.evaluator.benchmark.report import Results, figures
from services.evaluator.benchmark.sources import Model, SourceSpec, opened, plan_query
from services.evaluator.benchmark.variants import NO_PROBLEM, Group, Key, Protocol, Setting, Unit, Variant
from services.evaluator.cluster import on_cluster, spread
from services.names import EXPERIMENT, NOTE, TAG_STAGE
from services.planner.ompl_planner import solve
from services.planner.result import PlanResult
from services.planner.samples import SampleBatch
from services.registry.entities import ID
from services.registry.tracking import Tracking

Row = dict[str, Any]
FoundPath = NDArray[np.float64] | None
Show = Callable[[str], None]
Execute = Callable[[Sequence[Unit], Setting, Sequence[SourceSpec]], Iterator[list[Row]]]
Shared = tuple[Setting, tuple[SourceSpec, ...]]
# Columns with their pandas types; docs/benchmark.md describes them.
COLUMNS = {
    "protocol": "str", "source": "str", "family": "str", "problem": "int64", "pictures": "int64",
    "run": "int64", "seed": "int64", "variant": "str", "group": "str", "planner": "str", "sampler": "str",
    "learned_share": "float64", "samples": "int64", "solved": "bool", "status": "str",
    "iterations": "Int64", "edge_checks": "Int64", "state_checks": "Int64", "learned_drawn": "Int64",
    "uniform_drawn": "Int64", "length_rad": "float64",
    "solve_s": "float64", "state_check_s": "float64",
    "request_s": "float64", "server_s": "float64", "total_s": "float64",
    "confidence": "float64", "clearance_m": "float64", "meshes_free": "boolean",
    "search_s": "float64", "score_s": "float64", "bottleneck_rad": "float64",
}  # fmt: skip
# Spacing of the states at which a path is checked.
LOOK_RAD = 0.01
_STATES, _REPEATS = 5000, 5


@lru_cache(maxsize=1)
def _models(setting: Setting, specs: tuple[SourceSpec, ...]) -> dict[str, Model]:
    """Models that stay open as long as the process."""
    return opened(specs, setting.world, ExitStack(), plans=setting.protocol is Protocol.PLANS)


def run_unit(unit: Unit, shared: Shared) -> list[Row]:
    """The rows of a unit; nothing in them depends on another unit."""
    setting, problem = shared[0], shared[0].problem(unit)
    if problem is None:
        nothing = {"status": NO_PROBLEM, "solved": False}
        return [_row(setting, unit, variant, run) | nothing for variant, run in unit.todo]
    case, rows = _Case(problem, unit, setting, _models(*shared)), []
    # Each unit has its own order, so that no variant is always the one that finds the caches warm.
    first = setting.planner(unit.todo[0][0], unit.index, unit.todo[0][1]).seed
    for position in np.random.default_rng([first, 1]).permutation(len(unit.todo)):
        variant, run = unit.todo[position]
        rows.append(_row(setting, unit, variant, run) | case.solve(variant, run))
    return rows


def _row(setting: Setting, unit: Unit, variant: Variant, run: int) -> Row:
    source = ""
    if setting.protocol is Protocol.PLANS:
        sources = partly_seen(setting.world).sources
        source = next((name for name, families in sources.items() if unit.family in families), "")
    row: Row = {"protocol": setting.protocol.value, "source": source, "family": unit.family}
    row |= {"problem": unit.index, "pictures": unit.pictures, "run": run}
    row |= {"seed": setting.planner(variant, unit.index, run).seed, "variant": variant.name}
    row |= {"group": variant.group.value, "learned_share": variant.share}
    row |= {name: getattr(variant, name) for name in ("planner", "sampler", "samples")}
    return dict.fromkeys(COLUMNS) | row | {"request_s": 0.0, "search_s": 0.0, "score_s": 0.0}


class _Case:
    """A unit's problem, and what its variants share."""

    def __init__(self, problem: Problem, unit: Unit, setting: Setting, models: dict[str, Model]) -> None:
        self.problem, self.unit, self.setting, self.models = problem, unit, setting, models
        self.batch = cache(self._batch)

    @cached_property
    def image(self) -> Any:
        """What the depth cameras saw."""
        return self.problem.scenario.world.read_picture(picture_file_of(self.problem.scenario))

    @cached_property
    def meshes(self) -> Any:
        """Collision checks by meshes, if there are any."""
        return partly_seen(self.setting.world).mesh_checker(self.problem, self.unit.folder)

    def solve(self, variant: Variant, run: int) -> Row:
        """The measured columns of one run."""
        bottleneck_rad = self.problem.bottleneck_rad
        row: Row = {"bottleneck_rad": bottleneck_rad if math.isfinite(bottleneck_rad) else None}
        if variant.group is Group.PLANS:
            path, columns = self._search(variant.unseen) if variant.unseen else self._ask(variant.sampler)
            return row | columns | self._evaluated(path)
        settings = self.setting.planner(variant, self.unit.index, run)
        row["state_check_s"] = _state_check_s(self.problem)
        if variant.sampler is None:
            result = solve(self.problem, settings)
        else:
            batch = self.batch(variant.sampler, variant.query(settings.seed))
            result = solve(self.problem, settings, batch.samples, 1.0 - variant.share)
            row["request_s"] = batch.round_trip_s
            row["server_s"] = batch.server_s
        total_s = row.get("request_s", 0.0) + result.solve_time_s
        return row | _of_result(result) | {"total_s": total_s}

    def _batch(self, sampler: str, query: SampleQuery) -> SampleBatch:
        return self.models[sampler].sample(self.problem, query)

    def _ask(self, model: str | None) -> tuple[FoundPath, Row]:
        """A model's path of the highest confidence."""
        query = plan_query(self.problem, self.setting.seed, self.setting.time_limit_s)
        plan, request_s = self.models[model or ""].plan(self.problem, query)
        solved = plan.status == "solved"
        return plan.path if solved else None, {
            "status": plan.status,
            "confidence": plan.confidence if solved else None,
            "search_s": 1e-3 * plan.search_ms,
            "score_s": 1e-3 * plan.score_ms,
            "request_s": request_s,
        }

    def _search(self, unseen: UnseenPolicy) -> tuple[FoundPath, Row]:
        """The shortest path of a search by a fixed rule for unseen space."""
        problem = self.problem
        checkers = partly_seen(self.setting.world).checkers(problem, self.image, unseen)
        load_kernels(checkers[0], problem.start, LOOK_RAD)
        began, until_s = time.perf_counter(), time.thread_time() + self.setting.time_limit_s
        found = find_paths(checkers, problem.start, problem.goal, DEFAULT_PATHS, self.setting.seed, until_s)
        spent_s = time.perf_counter() - began
        shortest = min(found.paths, key=lambda path: length_rad(path, problem.space), default=None)
        status = "solved" if found.paths else "timeout" if found.late else "refused"
        return shortest, {"status": status, "search_s": spent_s, "request_s": spent_s}

    def _evaluated(self, path: FoundPath) -> Row:
        """A path in the true scene."""
        if path is None:
            return {"solved": False}
        states = spaced(path, self.problem.space, LOOK_RAD)
        return {
            "solved": True,
            "clearance_m": float(checker_of(self.problem.scenario).clearance(states).min()),
            "length_rad": length_rad(path, self.problem.space),
            "meshes_free": None if self.meshes is None else bool(self.meshes.valid_batch(states).all()),
        }


def _of_result(result: PlanResult) -> Row:
    names = ("solved", "iterations", "edge_checks", "state_checks", "learned_drawn", "uniform_drawn")
    return {name: getattr(result, name) for name in names} | {
        "status": str(result.reason),
        "length_rad": float(result.length_rad) if result.solved else None,
        "solve_s": result.solve_time_s,
    }


@lru_cache(maxsize=4)
def _state_check_s(problem: Problem) -> float:
    """Seconds for one state check, the fastest of some compiled loops over uniform states.

    The step from OMPL to Python does not count: it is the planner's.
    """
    checker, taken = checker_of(problem.scenario), []
    states = problem.space.sample_uniform(np.random.default_rng(0), _STATES)
    for _ in range(_REPEATS):
        began = time.perf_counter()
        checker.valid_batch(states)
        taken.append(time.perf_counter() - began)
    return min(taken) / _STATES


PARQUET, REPORT, RUNS, MANIFEST, FIGURES = (
    "runs.parquet", "report.md", "runs.jsonl", "manifest.json", "figures",
)  # fmt: skip
STAGE = "planning-benchmark"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Request:
    """What a benchmark runs: ``problems`` of each family, ``repeats`` of each but for the protocol plans.

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
                    yield Unit(family, index, tuple((one, 0) for one in own), seen, self.folder)
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
    plots = figures(results)
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

    def rows(self) -> list[Row]:
        """All runs in the order in which they came."""
        lines = self._path.read_text("utf-8").splitlines() if self._path.is_file() else []
        return [json.loads(line) for line in lines]

    def append(self, rows: Iterable[Row]) -> None:
        """Keep the runs of a unit."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))


def executor(environment: Mapping[str, str], count: int) -> Execute:
    """Over the Ray cluster where RAY_ADDRESS names one, else over so many processes of this machine."""
    return run_on_ray if on_cluster(environment) else processes(count)


def run_on_ray(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Row]]:
    """Runs as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again."""
    return spread(run_unit, work, (setting, tuple(specs)), "benchmark")


def processes(count: int) -> Execute:
    """Units over so many spawned processes of this machine, each of which computes on one core."""

    def run(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Row]]:
        for name in _ONE_THREAD:
            os.environ.setdefault(name, "1")
        shared = (setting, tuple(specs))
        with ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), end_with_parent) as pool:
            try:
                for done in as_completed([pool.submit(run_unit, unit, shared) for unit in work]):
                    yield done.result()
            finally:
                pool.shutdown(cancel_futures=True)

    return run


def end_with_parent() -> None:
    """In a process of a pool: ends when the process that made it has ended, in whatever way."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=follow, daemon=True).start()
