"""Runs of the benchmark: a problem solved by all variants of a unit with the same seed, a row each."""

import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import cache, lru_cache
from typing import Any

import numpy as np

from cspace.plan import load_kernels
from cspace.planning.paths import length_rad, spaced
from cspace.planning.search import find_paths
from cspace.query import DEFAULT_PATHS, AlternativePath, SampleQuery
from cspace.simulator import Problem
from cspace.simulator import Taken as Unseen
from cspace.worlds import checker_of, partly_seen, picture_file_of
from services.evaluator.benchmark.sources import Model, SourceSpec, opened, plan_query
from services.evaluator.benchmark.variants import Group, Protocol, Setting, Unit, Variant
from services.planner.ompl_planner import solve
from services.planner.result import PlanResult
from services.planner.rrt_connect import solve_with_paths
from services.planner.samples import SampleBatch

Row = dict[str, Any]
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
    "search_s": "float64", "score_s": "float64", "as_is": "boolean", "bottleneck_rad": "float64",
}  # fmt: skip
# Status of a problem whose start or goal collides; it is left out.
NO_PROBLEM = "start or goal collides"
# Spacing of the states at which a path is checked.
LOOK_RAD = 0.01
_STATES, _REPEATS = 5000, 5


class Worker:
    """Runs units in one process; the models stay open as long as it exists."""

    def __init__(self, setting: Setting, specs: Sequence[SourceSpec]) -> None:
        self._setting, self._open = setting, ExitStack()
        plans = setting.protocol is Protocol.PLANS
        self._models = opened(specs, setting.world, self._open, plans=plans)

    def run(self, unit: Unit) -> list[Row]:
        """The rows of a unit; nothing in them depends on another unit."""
        setting, problem = self._setting, self._setting.problem(unit)
        if problem is None:
            nothing = {"status": NO_PROBLEM, "solved": False}
            return [self._row(unit, variant, run) | nothing for variant, run in unit.todo]
        case = _Case(problem, unit, setting, self._models)
        rows = []
        # Each unit has its own order, so that no variant is always the one that finds the caches warm.
        first = setting.planner(unit.todo[0][0], unit.index, unit.todo[0][1]).seed
        for position in np.random.default_rng([first, 1]).permutation(len(unit.todo)):
            variant, run = unit.todo[position]
            rows.append(self._row(unit, variant, run) | case.solve(variant, run))
        return rows

    def _row(self, unit: Unit, variant: Variant, run: int) -> Row:
        setting, source = self._setting, ""
        if setting.protocol is Protocol.PLANS:
            sources = partly_seen(setting.world).sources
            source = next((name for name, families in sources.items() if unit.family in families), "")
        return dict.fromkeys(COLUMNS) | {
            "protocol": setting.protocol.value,
            "source": source,
            "family": unit.family,
            "problem": unit.index,
            "pictures": unit.pictures,
            "run": run,
            "seed": setting.planner(variant, unit.index, run).seed,
            "variant": variant.name,
            "group": variant.group.value,
            "planner": variant.planner,
            "sampler": variant.sampler,
            "learned_share": variant.share,
            "samples": variant.samples,
            "request_s": 0.0,
            "search_s": 0.0,
            "score_s": 0.0,
        }


class _Case:
    """A unit's problem, and what its variants share: batches of samples, paths, and prices of a check."""

    def __init__(self, problem: Problem, unit: Unit, setting: Setting, models: dict[str, Model]) -> None:
        self.problem, self.unit, self.setting, self.models = problem, unit, setting, models
        self.truth = checker_of(problem.scenario)
        self.seen = self.meshes = None
        if setting.protocol is Protocol.PLANS:
            self.seen = partly_seen(setting.world)
            self.meshes = self.seen.mesh_checker(problem, unit.folder)
            self.image = problem.scenario.world.read_picture(picture_file_of(problem.scenario))
        self.batch = cache(self._batch)
        self.paths = cache(self._paths)

    def solve(self, variant: Variant, run: int) -> Row:
        """The measured columns of one run."""
        bottleneck_rad = self.problem.bottleneck_rad
        row: Row = {"bottleneck_rad": bottleneck_rad if math.isfinite(bottleneck_rad) else None}
        if variant.group is Group.PLANS:
            paths, times = self.paths(variant.sampler, variant.unseen)
            return row | times | self._evaluated(paths)
        settings = self.setting.planner(variant, self.unit.index, run)
        row["state_check_s"] = _state_check_s(self.problem)
        if variant.sampler is None and variant.unseen is None:
            result = solve(self.problem, settings)
        elif variant.group is Group.PATHS:
            paths, times = self.paths(variant.sampler, variant.unseen)
            result = solve_with_paths(self.problem, settings, paths)
            row |= times | {"as_is": result.solved and result.iterations == 0}
        else:
            batch = self.batch(variant.sampler, variant.query(settings.seed))
            result = solve(self.problem, settings, batch.samples, 1.0 - variant.share)
            row["request_s"] = batch.round_trip_s
            row["server_s"] = None if batch.timing is None else batch.timing.total_s
        total_s = row.get("request_s", 0.0) + result.solve_time_s
        return row | _of_result(result) | {"total_s": total_s}

    def _batch(self, sampler: str, query: SampleQuery) -> SampleBatch:
        return self.models[sampler].sample(self.problem, query)

    def _paths(self, sampler: str | None, unseen: Unseen | None) -> tuple[tuple[AlternativePath, ...], Row]:
        """The paths of a model, or of a search by a fixed rule, the best first; and their columns."""
        limit_s = self.setting.plan_limit_s
        if sampler is not None:
            query = plan_query(self.problem, self.setting.seed, limit_s)
            plan, request_s = self.models[sampler].plan(self.problem, query)
            solved = plan.status == "solved"
            return plan.alternatives, {
                "status": plan.status,
                "confidence": plan.confidence if solved else None,
                "search_s": 1e-3 * plan.search_ms,
                "score_s": 1e-3 * plan.score_ms,
                "request_s": request_s,
            }
        assert self.seen is not None and unseen is not None  # noqa: S101, PT018 - of the protocol plans only
        problem, checkers = self.problem, self.seen.checkers(self.problem, self.image, unseen)
        load_kernels(checkers[0], problem.start, LOOK_RAD)
        began, until_s = time.perf_counter(), time.thread_time() + limit_s
        found = find_paths(checkers, problem.start, problem.goal, DEFAULT_PATHS, self.setting.seed, until_s)
        spent_s = time.perf_counter() - began
        shortest = sorted(found.paths, key=lambda path: length_rad(path, problem.space))
        paths = tuple(AlternativePath(path, 1.0, np.ones(len(path) - 1, np.float32)) for path in shortest)
        status = "solved" if paths else "timeout" if found.late else "refused"
        return paths, {"status": status, "search_s": spent_s, "request_s": spent_s}

    def _evaluated(self, paths: Sequence[AlternativePath]) -> Row:
        """The first path in the true scene."""
        if not paths:
            return {"solved": False}
        path, space = paths[0].path, self.problem.space
        states = spaced(path, space, LOOK_RAD)
        row: Row = {
            "solved": True,
            "clearance_m": float(self.truth.clearance(states).min()),
            "length_rad": length_rad(path, space),
        }
        if self.meshes is not None:
            row["meshes_free"] = bool(self.meshes.valid_batch(states).all())
        return row


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
