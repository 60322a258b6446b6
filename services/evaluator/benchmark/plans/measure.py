"""A problem planned by all arms of a unit, one after the other in this process."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.connecting import length_rad, spaced
from cspace.planning.compiled import load_kernels
from cspace.planning.query import BelievedWay
from cspace.planning.ways import find_ways
from cspace.problem import Problem
from cspace.workshop import Checker
from cspace.worlds import checker_of, picture_file_of, workshop_of
from cspace.worlds.unseen import Judge, Taken
from services.evaluator.benchmark.measure import state_check_s
from services.evaluator.benchmark.plans.planners import Answer, Planner, opened_planners, plan_query
from services.evaluator.benchmark.plans.setting import (
    BASE,
    NO_PROBLEM,
    PlanArm,
    PlanRun,
    PlanSetting,
    PlanUnit,
    Table,
)
from services.evaluator.benchmark.sources import SourceSpec
from services.planner.search.ompl_planner import solve
from services.planner.search.ways_first import solve_with_ways

Way = NDArray[np.float64]
# How closely ways are looked at: for collisions, and for what of the arm is seen along them.
LOOK_RAD, UNSEEN_RAD = 0.01, 0.1
_MESH_STATES, _REPEATS = 200, 3


@dataclass(frozen=True, slots=True, eq=False)
class Ways:
    """What an arm found before any exact check.

    Args:
        ways: the arm's choice first.
        status: ``solved``, ``refused`` or ``timeout``.
        confidence: of the first; None where no model was asked.
        search_s: looking for them.
        score_s: asking the model.
        request_s: all of it.
    """

    ways: tuple[BelievedWay, ...]
    status: str
    confidence: float | None
    search_s: float
    score_s: float
    request_s: float


NONE = Ways((), "", None, 0.0, 0.0, 0.0)


class PlanWorker:
    """What a process keeps between units: the setting, and the models, open as long as it is.

    Raises:
        SamplerError: a model does not answer.
    """

    def __init__(self, setting: PlanSetting, specs: Sequence[SourceSpec]) -> None:
        self._setting, self._open = setting, ExitStack()
        self._planners = self._open.enter_context(opened_planners(specs, setting.world))

    def run(self, unit: PlanUnit) -> list[PlanRun]:
        """One unit."""
        return measure(unit, self._setting, self._planners)


def measure(unit: PlanUnit, setting: PlanSetting, planners: Mapping[str, Planner]) -> list[PlanRun]:
    """Run the arms of a unit; nothing that a run holds depends on another unit.

    Raises:
        SamplerError: a model does not answer.
    """
    # Arms to which pictures do not matter are told the scene all the same.
    seen, asked = setting.seen, setting.asked(unit.folder)
    problem = seen.problem(asked, unit.family, unit.index, max(1, unit.pictures))
    if problem is None:
        told = {"status": NO_PROBLEM, "solved": False}
        return [_record(unit, setting, arm, run, told) for arm, runs in unit.runs for run in runs]
    picture = picture_file_of(problem.scenario)
    world = problem.scenario.world
    image, judge = world.read_picture(picture), seen.judge(problem)
    truth = checker_of(problem.scenario)

    # Arms of one model, or of one belief, share its ways.
    @cache
    def found(sampler: str | None, taken: Taken | None) -> Ways:
        if sampler is not None:
            query = plan_query(problem, setting.seed, setting.plan_limit_s, setting.ways)
            return planned(planners[sampler].plan(picture, query, world))
        return NONE if taken is None else searched(seen.checkers(problem, image, taken), problem, setting)

    @cache
    def prices() -> dict[str, float | None]:
        return _prices(problem, setting, judge)

    def share(rows: Way) -> Way:
        return seen.unseen(image, rows)

    records = []
    for arm, runs in unit.runs:
        ways = found(arm.sampler, arm.taken)
        for run in runs:
            if arm.table is Table.UNCHECKED:
                told = judged(ways, truth, judge, share if unit.pictures else None)
            else:
                told = checked(None if arm == BASE else ways, problem, setting, unit.index, run)
                told |= prices()
            records.append(_record(unit, setting, arm, run, told))
    return records


def planned(answer: Answer) -> Ways:
    """A model's ways, the surest first."""
    plan = answer.plan
    times = 1e-3 * plan.search_ms, 1e-3 * plan.score_ms, answer.request_s
    confidence = plan.confidence if plan.status == "solved" else None
    return Ways(plan.alternatives, plan.status, confidence, *times)


def searched(checkers: Sequence[Checker], problem: Problem, setting: PlanSetting) -> Ways:
    """Ways in what checkers take the scene to be, the shortest first."""
    space, ends = problem.space, (problem.start, problem.goal)
    load_kernels(checkers[0], problem.start, UNSEEN_RAD)
    began = time.perf_counter()
    until_s = time.thread_time() + setting.plan_limit_s
    found = find_ways(checkers, *ends, setting.ways, setting.seed, until_s)
    spent_s = time.perf_counter() - began
    ways = sorted(found.ways, key=lambda way: length_rad(way, space))
    believed = tuple(BelievedWay(way, 1.0, np.ones(len(way) - 1, dtype=np.float32)) for way in ways)
    status = "solved" if believed else "timeout" if found.late else "refused"
    return Ways(believed, status, None, spent_s, 0.0, spent_s)


def judged(
    ways: Ways, truth: Checker, judge: Judge | None, unseen: Callable[[Way], Way] | None
) -> dict[str, Any]:
    """An arm's choice as it is in truth.

    Args:
        ways: that the arm found.
        truth: the scene itself.
        judge: by meshes; None where these are not installed.
        unseen: share of the arm that pictures do not show, at (n, d) rad; None without pictures.
    """
    told: dict[str, Any] = _found(ways) | {"status": ways.status, "solved": bool(ways.ways)}
    if not ways.ways:
        return told
    way, space = ways.ways[0].way, truth.space
    states = spaced(way, space, LOOK_RAD)
    return told | {
        "confidence": ways.confidence,
        "clearance_m": float(truth.clearance(states).min()),
        "meshes_free": None if judge is None else bool(judge.valid_batch(states).all()),
        "unseen": None if unseen is None else float(unseen(spaced(way, space, UNSEEN_RAD)).mean()),
        "length_rad": length_rad(way, space),
    }


def checked(
    ways: Ways | None, problem: Problem, setting: PlanSetting, index: int, run: int
) -> dict[str, Any]:
    """A search with exact checks that begins with the ways; without them where they are None."""
    settings = setting.planner(index, run)
    result = solve(problem, settings) if ways is None else solve_with_ways(problem, settings, ways.ways)
    return _found(ways or NONE) | {
        "status": str(result.reason),
        "solved": result.solved,
        "length_rad": float(result.length_rad) if result.solved else None,
        "as_is": result.solved and result.iterations == 0,
        "state_checks": result.state_checks,
        "edge_checks": result.edge_checks,
        "iterations": result.iterations,
        "solve_s": result.solve_time_s,
    }


def _found(ways: Ways) -> dict[str, float]:
    return {"search_s": ways.search_s, "score_s": ways.score_s, "request_s": ways.request_s}


def _prices(problem: Problem, setting: PlanSetting, judge: Judge | None) -> dict[str, float | None]:
    measures = workshop_of(setting.world).measures
    spheres_s = state_check_s(problem, measures.range_rad, measures.resolution_rad)
    return {
        "state_check_s": spheres_s,
        "mesh_check_s": None if judge is None else _mesh_check_s(problem, judge),
    }


def _mesh_check_s(problem: Problem, judge: Judge) -> float:
    """Seconds a configuration, uniform ones free by spheres, the fastest of some loops."""
    drawn = problem.space.sample_uniform(np.random.default_rng(0), 8 * _MESH_STATES)
    rows = drawn[checker_of(problem.scenario).valid_batch(drawn)][:_MESH_STATES]
    taken = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        judge.valid_batch(rows)
        taken.append(time.perf_counter() - began)
    return min(taken) / max(1, len(rows))


_NOTHING: dict[str, Any] = {"search_s": 0.0, "score_s": 0.0, "request_s": 0.0} | dict.fromkeys(
    (
        "confidence",
        "clearance_m",
        "meshes_free",
        "unseen",
        "length_rad",
        "as_is",
        "state_checks",
        "edge_checks",
        "iterations",
        "solve_s",
        "state_check_s",
        "mesh_check_s",
    )
)


def _record(unit: PlanUnit, setting: PlanSetting, arm: PlanArm, run: int, told: Mapping[str, Any]) -> PlanRun:
    sources = setting.seen.sources
    return PlanRun(
        table=arm.table.value,
        source=next((name for name, families in sources.items() if unit.family in families), ""),
        family=unit.family,
        problem=unit.index,
        pictures=unit.pictures,
        run=run,
        arm=arm.name,
        sampler=arm.sampler,
        **{**_NOTHING, **told},
    )
