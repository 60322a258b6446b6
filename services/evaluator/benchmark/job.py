"""The job of a benchmark: run what is missing, write table, report and figures, log them."""

import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
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

from cspace.bundle import Bundle, load_verified
from cspace.errors import ConfigError, StorageError
from cspace.files import make_output_folder, replacing
from cspace.plan import load_kernels
from cspace.planning.paths import length_rad, spaced
from cspace.planning.search import find_paths
from cspace.query import DEFAULT_PATHS, Plan, PlanQuery, SampleQuery
from cspace.simulator import UNIFORM, Problem, Split, UnseenPolicy
from cspace.world import World
from cspace.worlds import checker_of, partly_seen, picture_file_of, robot_digest, simulator_of
from services.commands import Progress
from services.evaluator.benchmark.report import Results, figures
from services.evaluator.benchmark.variants import NO_PROBLEM, Group, Key, Protocol, Setting, Unit, Variant
from services.evaluator.cluster import on_cluster, spread
from services.evaluator.scenes import PackedBundle
from services.names import EXPERIMENT, NOTE, TAG_STAGE
from services.planner.ompl_planner import solve
from services.planner.planning import between_ends
from services.planner.result import PlanResult
from services.planner.samples import BundleSampler, SampleBatch
from services.registry.entities import ID
from services.registry.tracking import Tracking

Row = dict[str, Any]
FoundPath = NDArray[np.float64] | None
Show = Callable[[str], None]
# Packed bundles by the names of their models.
Models = tuple[tuple[str, PackedBundle], ...]
Shared = tuple[Setting, Models]
Execute = Callable[[Sequence[Unit], Setting, Models], Iterator[list[Row]]]
# Columns with their pandas types; docs/benchmark.md describes them.
COLUMNS = {
    "protocol": "str", "source": "str", "family": "str", "problem": "int64", "pictures": "int64",
    "run": "int64", "seed": "int64", "variant": "str", "group": "str", "planner": "str", "sampler": "str",
    "learned_share": "float64", "samples": "int64", "solved": "bool", "status": "str",
    "iterations": "Int64", "edge_checks": "Int64", "state_checks": "Int64", "learned_drawn": "Int64",
    "uniform_drawn": "Int64", "length_rad": "float64",
    "solve_s": "float64", "state_check_s": "float64",
    "request_s": "float64", "total_s": "float64",
    "confidence": "float64", "clearance_m": "float64", "meshes_free": "boolean",
    "search_s": "float64", "score_s": "float64", "bottleneck_rad": "float64",
}  # fmt: skip
# Spacing of the states at which a path is checked.
LOOK_RAD = 0.01
_STATES, _REPEATS = 5000, 5


def packed_bundle(folder: Path, plans_for: World | None = None) -> PackedBundle:
    """A bundle's files for all workers; with a world it has to plan for its robot."""
    bundle = load_verified(folder)
    if plans_for is not None and not (bundle.has_validity and bundle.robot == robot_digest(plans_for)):
        raise ConfigError(
            f"the bundle {folder} does not plan for this robot",
            expected="a validity head, and the robot of --robot",
            got=f"{'one' if bundle.has_validity else 'none'}, robot {bundle.robot[:12]}",
        )
    return PackedBundle.pack(bundle)


@lru_cache(maxsize=1)
def _opened(setting: Setting, models: Models) -> dict[str, Bundle]:
    """Bundles that stay open as long as the process; each is used once, so that no run pays for that."""
    problem = simulator_of(setting.world).problem(UNIFORM, Split.DEMO, 0)
    bundles = {name: packed.load() for name, packed in models}
    for bundle in bundles.values():
        if setting.protocol is Protocol.PLANS:
            _plan(bundle, problem, 0, 1.0)
        else:
            _sample(bundle, problem, SampleQuery(10, 1, min_confidence=0.0))
    return bundles


def _sample(bundle: Bundle, problem: Problem, query: SampleQuery) -> SampleBatch:
    """One batch for a problem's picture; path models are asked with start and goal."""
    sampler = BundleSampler(bundle, robot=robot_digest(problem.scenario.world))
    query = between_ends(query, problem) if sampler.with_ends else query
    return sampler.answer(picture_file_of(problem.scenario), query)


def _plan(bundle: Bundle, problem: Problem, seed: int, time_limit_s: float) -> Plan:
    """The path of the highest confidence and all others, at any confidence, in the limits of the problem."""
    world = problem.scenario.world
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    query = PlanQuery(start, goal, seed, 0.0, time_limit_s, DEFAULT_PATHS, alternatives=True)
    own = bundle.within(world)
    return own.plan(own.prepare(world.examine_picture(picture_file_of(problem.scenario))), query)


def run_unit(unit: Unit, shared: Shared) -> list[Row]:
    """The rows of a unit; nothing in them depends on another unit."""
    setting, problem = shared[0], shared[0].problem(unit)
    if problem is None:
        nothing = {"status": NO_PROBLEM, "solved": False}
        return [_row(setting, unit, variant, run) | nothing for variant, run in unit.todo]
    case, rows = _Case(problem, unit, setting, _opened(*shared)), []
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

    def __init__(self, problem: Problem, unit: Unit, setting: Setting, models: dict[str, Bundle]) -> None:
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
            path, columns = (
                self._search(variant.unseen) if variant.unseen else self._ask(str(variant.sampler))
            )
            return row | columns | self._evaluated(path)
        settings = self.setting.planner(variant, self.unit.index, run)
        row["state_check_s"] = _state_check_s(self.problem)
        if variant.sampler is None:
            result = solve(self.problem, settings)
        else:
            query = SampleQuery(variant.samples, settings.seed, min_confidence=0.0)
            batch = self.batch(variant.sampler, query)
            result = solve(self.problem, settings, batch.samples, 1.0 - variant.share)
            row["request_s"] = batch.round_trip_s
        total_s = row.get("request_s", 0.0) + result.solve_time_s
        return row | _of_result(result) | {"total_s": total_s}

    def _batch(self, sampler: str, query: SampleQuery) -> SampleBatch:
        return _sample(self.models[sampler], self.problem, query)

    def _ask(self, model: str) -> tuple[FoundPath, Row]:
        """A model's path of the highest confidence."""
        began = time.perf_counter()
        plan = _plan(self.models[model], self.problem, self.setting.seed, self.setting.time_limit_s)
        request_s = time.perf_counter() - began
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
    models: Models
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
        for found in execute(work, request.setting, request.models) if work else ():
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
        samplers = {name: packed.digest for name, packed in request.models}
        run.params({"setting": asdict(setting), "samplers": samplers})
        run.metrics(results.metrics(), 0)
        run.table(results.columns(), "variants")
        run.tags({NOTE: results.note()})
        for part in (MANIFEST, PARQUET, REPORT):
            run.artifact(out / part)
        for name, figure in plots.items():
            run.figure(figure, name)
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
            "samplers": {name: packed.digest for name, packed in request.models},
        }
        # As JSON has it: lists for tuples.
        self.manifest = json.loads(json.dumps(described))
        try:
            make_output_folder(request.out)
            old = json.loads(manifest.read_text("utf-8")) if manifest.is_file() else {}
            self._join(old)
            with replacing(manifest) as beside:
                beside.write_text(json.dumps(self.manifest, indent=1), encoding="utf-8")
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
    if on_cluster(environment):
        return lambda work, setting, models: spread(run_unit, work, (setting, models), "benchmark")
    return processes(count)


def processes(count: int) -> Execute:
    """Units over so many spawned processes of this machine, each of which computes on one core."""

    def run(work: Sequence[Unit], setting: Setting, models: Models) -> Iterator[list[Row]]:
        for name in _ONE_THREAD:
            os.environ.setdefault(name, "1")
        shared = (setting, models)
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
