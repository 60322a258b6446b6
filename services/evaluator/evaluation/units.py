"""One evaluation: units of work measured one by one, then put together into tables with intervals."""

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from cspace.errors import EvaluationError, ScenarioError
from cspace.problem import UNIFORM, Problem
from cspace.splits import Split
from cspace.world import World
from cspace.worlds import workshop_of
from services.evaluator.evaluation.budget import Budget, Kind, Unit, planned
from services.evaluator.measures.planning import PlanningTrial, plan_trial
from services.evaluator.measures.planning_summary import FamilySummary, success_rate, summarise_family
from services.evaluator.measures.reconstruction import ReconstructionSummary, SceneQuality, summarise
from services.evaluator.measures.scenes import Scene, Stage, reconstruct, summary_rng
from services.evaluator.measures.topology_scenes import (
    SceneTopology,
    ScoreSummary,
    scene_topology,
    summarise_topology,
)
from services.evaluator.statistics import Interval
from services.planner.search.ompl_planner import PlannerSettings
from services.planner.sources.samples import SampleSource


@dataclass(frozen=True, slots=True)
class Drawn:
    """A problem that a unit drew, so that nobody searches for it again."""

    index: int
    problem: Problem


Row = SceneQuality | SceneTopology | PlanningTrial | Drawn


@dataclass(frozen=True, slots=True)
class Setting:
    """What an evaluation is about: arm, camera, seed, how much, and whether of a path model."""

    world: World
    seed: int
    budget: Budget
    paths: bool = False


@dataclass(frozen=True, slots=True)
class UnitResult:
    """The rows of one unit of work, and the time that it took."""

    unit: Unit
    rows: tuple[Row, ...]
    seconds: float


@dataclass(frozen=True, slots=True)
class SplitResult:
    """All of one split: summaries with the rows behind them.

    ``reconstruction`` is of the uniform scenarios, ``families`` of the others; ``scenes`` are of all. Path
    models have none of the three. ``problems`` are those of the scenes and trials by family and index.
    """

    reconstruction: ReconstructionSummary | None
    planning: tuple[FamilySummary, ...]
    planning_success: Interval | None
    scenes: tuple[SceneQuality, ...]
    trials: tuple[PlanningTrial, ...]
    families: Mapping[str, ReconstructionSummary]
    problems: Mapping[tuple[str, int], Problem] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Validation decides, test is reported; topology is of test scenarios."""

    setting: Setting
    validation: SplitResult
    test: SplitResult
    topology: Mapping[str, ScoreSummary]
    topology_scenes: tuple[SceneTopology, ...]
    cpu_seconds: float


def run_unit(unit: Unit, setting: Setting, sampler: SampleSource) -> UnitResult:
    """Measure one unit of work; its rows depend on nothing else.

    Raises:
        EvaluationError: a path model is asked for samples of the free space.
    """
    began = time.perf_counter()
    if unit.kind is Kind.PLANNING:
        rows = _planning_rows(unit, setting, sampler)
    elif sampler.with_ends:
        raise EvaluationError("path models are judged by planning alone", got=str(unit.kind))
    else:
        measure = _reconstruction_rows if unit.kind is Kind.RECONSTRUCTION else _topology_rows
        rows = measure(unit, setting, sampler)
    return UnitResult(unit, tuple(rows), time.perf_counter() - began)


def assemble(results: Iterable[UnitResult], setting: Setting) -> Evaluation:
    """Put the results together, in whatever order they came.

    Raises:
        EvaluationError: a group is empty.
    """
    done = sorted(results, key=lambda result: (result.unit.family or "", result.unit.first))
    rng = summary_rng(setting.seed)
    shapes = [row for row in _rows(done, Split.TEST) if isinstance(row, SceneTopology)]
    return Evaluation(
        setting,
        _split_result(_rows(done, Split.VALIDATION), rng, setting),
        _split_result(_rows(done, Split.TEST), rng, setting),
        summarise_topology(shapes, rng) if shapes else {},
        tuple(shapes),
        sum(result.seconds for result in done),
    )


def _split_result(rows: Sequence[Row], rng: np.random.Generator, setting: Setting) -> SplitResult:
    families = workshop_of(setting.world).families
    scenes = tuple(row for row in rows if isinstance(row, SceneQuality))
    trials = tuple(row for row in rows if isinstance(row, PlanningTrial))
    present = {trial.family for trial in trials}
    by_family = {family: [scene for scene in scenes if scene.family == family] for family in families.names}
    # Resampling of its own leaves the other intervals as they are in an evaluation without families.
    (apart,) = rng.spawn(1)
    uniform = by_family.pop(UNIFORM)
    return SplitResult(
        None if setting.paths else summarise(uniform, rng),
        tuple(summarise_family(family, trials, rng) for family in planned(families) if family in present),
        success_rate(trials) if trials else None,
        scenes,
        trials,
        {family: summarise(mine, apart) for family, mine in by_family.items() if mine},
        {(row.problem.family, row.index): row.problem for row in rows if isinstance(row, Drawn)},
    )


def _rows(results: Sequence[UnitResult], split: Split) -> list[Row]:
    return [row for result in results if result.unit.split == split for row in result.rows]


def _stage(unit: Unit, setting: Setting) -> Stage:
    return Stage(setting.world, unit.split, setting.seed)


def _scenes(unit: Unit, setting: Setting) -> list[Scene]:
    stage, family = _stage(unit, setting), unit.family or UNIFORM
    return [Scene(stage, index, family) for index in range(unit.first, unit.first + unit.count)]


def _reconstruction_rows(unit: Unit, setting: Setting, sampler: SampleSource) -> list[Row]:
    rows: list[Row] = []
    # Not all scenes have problems of every family.
    missing = () if unit.family in (None, UNIFORM) else (ScenarioError,)
    for scene in _scenes(unit, setting):
        with suppress(*missing):
            rows.append(reconstruct(scene, sampler, setting.budget.samples))
            if scene.problem is not None:
                rows.append(Drawn(scene.index, scene.problem))
    return rows


def _topology_rows(unit: Unit, setting: Setting, sampler: SampleSource) -> list[Row]:
    budget = setting.budget
    return [
        scene_topology(scene, sampler, budget.draws, budget.topology_samples)
        for scene in _scenes(unit, setting)
    ]


def _planning_rows(unit: Unit, setting: Setting, sampler: SampleSource) -> list[Row]:
    if unit.family is None:
        raise EvaluationError("a unit of planning names no family", got=str(unit))
    rows: list[Row] = []
    workshop, planner = workshop_of(setting.world), planner_of(setting.world)
    for index in range(unit.first, unit.first + unit.count):
        try:
            problem = workshop.problem(unit.family, unit.split, setting.seed, index)
        except ScenarioError:
            if unit.family == UNIFORM:
                raise
            continue
        rows.append(Drawn(index, problem))
        for repeat in range(setting.budget.planner_seeds):
            seed = planner_seed(setting.seed, index, repeat)
            rows.append(plan_trial(problem, index, seed, sampler, planner))
        wanted = (
            unit.family == workshop.families.telling != UNIFORM and index < setting.budget.narrow_scenarios
        )
        if wanted and not sampler.with_ends:
            scene = Scene(_stage(unit, setting), index, unit.family, problem)
            rows.append(reconstruct(scene, sampler, setting.budget.samples))
    return rows


def planner_of(world: World) -> PlannerSettings:
    """The planner of every evaluation in a world, named in the report.

    A limit in iterations makes a run independent of the machine's load, which the limit in time only guards.
    """
    measures = workshop_of(world).measures
    return PlannerSettings(
        planner="RRT",
        range_rad=measures.range_rad,
        resolution_rad=measures.resolution_rad,
        goal_bias=0.05,
        time_limit_s=10.0,
        max_iterations=1000,
        seed=1,
    )


def planner_seed(seed: int, index: int, repeat: int) -> int:
    """The seed of one run, in 1...2^31 - 1; OMPL takes no zero."""
    state = np.random.SeedSequence(entropy=seed, spawn_key=(98, index, repeat)).generate_state(1)
    return 1 + int(state[0]) % (2**31 - 1)
