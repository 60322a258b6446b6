"""Units of work of an evaluation: cut by a budget, measured one by one, and put together with intervals."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from cspace.errors import ConfigError, EvaluationError, ScenarioError
from cspace.simulator import UNIFORM, Families, Split
from cspace.world import World
from cspace.worlds import simulator_of
from services.evaluator.measures.planning import (
    FamilySummary,
    PlanningTrial,
    plan_trial,
    success_rate,
    summarise_family,
)
from services.evaluator.measures.sample_quality import ReconstructionSummary, SceneQuality, summarise
from services.evaluator.measures.scenes import Scene, Stage, reconstruct, summary_rng
from services.evaluator.measures.topology import (
    POINTS,
    SceneTopology,
    ScoreSummary,
    scene_topology,
    summarise_topology,
)
from services.evaluator.statistics import Interval
from services.planner.samples import SampleSource
from services.planner.settings import PlannerSettings
from services.registry.entities import ModelReference

EVALUATED_SPLITS = (Split.VALIDATION, Split.TEST)


class Kind(StrEnum):
    """What a unit of work measures."""

    RECONSTRUCTION = "reconstruction"
    TOPOLOGY = "topology"
    PLANNING = "planning"


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is evaluated.

    Args:
        scenarios: per split, for reconstruction; they alone decide.
        samples: per scenario and sampler.
        validation_problems: planning problems per family that decide.
        test_problems: planning problems per family that are only reported.
        planner_seeds: runs per problem.
        topology_scenarios: of the test split, for GS and GS-C, which decide nothing.
        draws: of landmarks per cloud and turn.
        narrow_scenarios: per split, for reconstruction; those of the first planning problems of the family
            that tells most, as drawing one takes long, so no more than there are.
        disconnected_scenarios: per split, for reconstruction, of each family without a solution.
        topology_samples: points per cloud for GS and GS-C.
    """

    scenarios: int
    samples: int
    validation_problems: int
    test_problems: int
    planner_seeds: int
    topology_scenarios: int
    draws: int
    narrow_scenarios: int = 0
    disconnected_scenarios: int = 0
    topology_samples: int = POINTS


QUICK = Budget(60, 1000, 30, 10, 1, 3, 50, narrow_scenarios=10, disconnected_scenarios=5)
FULL = Budget(500, 1000, 200, 200, 3, 50, 200, narrow_scenarios=100, disconnected_scenarios=100)
BUDGETS = {"quick": QUICK, "full": FULL}


@dataclass(frozen=True, slots=True)
class Unit:
    """Neighbouring scenarios of a split, or problems of a family; None: scenarios as in training."""

    kind: Kind
    split: Split
    first: int
    count: int
    family: str | None = None


@dataclass(frozen=True, slots=True)
class Setting:
    """What an evaluation is about: arm, camera, seed, how much, and whether of a path model."""

    world: World
    seed: int
    budget: Budget
    paths: bool = False


def units(setting: Setting) -> list[Unit]:
    """All units of an evaluation, the long ones first, so that workers end together.

    Path models are evaluated by planning alone. Of given scenes, no more are taken than there are.
    """
    budget, simulator = setting.budget, simulator_of(setting.world)
    families = simulator.families

    def at_most(count: int, split: Split) -> int:
        known = simulator.count(split)
        return count if known is None else min(count, known)

    problems = {Split.VALIDATION: budget.validation_problems, Split.TEST: budget.test_problems}
    work: list[Unit] = []
    for family in planned(families):
        for split in EVALUATED_SPLITS:
            work += [Unit(Kind.PLANNING, split, *part, family) for part in _parts(problems[split], 5)]
    if setting.paths:
        return work
    for family in families.unsolvable:
        for split in EVALUATED_SPLITS:
            parts = _parts(budget.disconnected_scenarios, 5)
            work += [Unit(Kind.RECONSTRUCTION, split, *part, family) for part in parts]
    work += [
        Unit(Kind.TOPOLOGY, Split.TEST, *part)
        for part in _parts(at_most(budget.topology_scenarios, Split.TEST), 1)
    ]
    for split in EVALUATED_SPLITS:
        work += [
            Unit(Kind.RECONSTRUCTION, split, *part) for part in _parts(at_most(budget.scenarios, split), 15)
        ]
    return work


def deciding(work: Iterable[Unit]) -> list[Unit]:
    """The units that decide: those that a rival is measured by as well."""
    return [
        unit
        for unit in work
        if unit.split is Split.VALIDATION and (unit.kind is Kind.PLANNING or unit.family is None)
    ]


def planned(families: Families) -> tuple[str, ...]:
    """The families that a planner is asked to solve, the one that tells most first."""
    return tuple(dict.fromkeys((families.decisive, *families.solvable)))


def _parts(count: int, size: int) -> Iterator[tuple[int, int]]:
    for first in range(0, count, size):
        yield first, min(size, count - first)


MAX_SEED = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Request:
    """One evaluation.

    Args:
        model: the version under test.
        budget: how much is evaluated.
        seed: of scenarios, samples and problems.
        promote: whether the decision is recorded and the alias moved.
        data: a data set whose held-out scenes it is evaluated on; None for those of the version's own data.
        shipped: folder of the shipped model, which the version is compared with; None leaves that out.
    """

    model: ModelReference
    budget: Budget
    seed: int = 0
    promote: bool = True
    data: Path | None = None
    shipped: Path | None = None


def make_request(
    model: str, *, budget: str = "quick", scenarios: int | None = None, **others: Any
) -> Request:
    """A request from the command line; ``scenarios`` per split replace those of the budget.

    Raises:
        ConfigError: a value is out of range.
    """
    if budget not in BUDGETS:
        raise ConfigError("the budget is unknown", expected=" or ".join(BUDGETS), got=repr(budget))
    if scenarios is not None and scenarios < 1:
        raise ConfigError("there are too few scenarios", expected="at least 1", got=str(scenarios))
    chosen = BUDGETS[budget] if scenarios is None else replace(BUDGETS[budget], scenarios=scenarios)
    request = Request(ModelReference.parse_version(model, "the model reference is unknown"), chosen, **others)
    if not 0 <= request.seed <= MAX_SEED:
        raise ConfigError("the seed is out of range", expected=f"0 to {MAX_SEED}", got=str(request.seed))
    return request


Row = SceneQuality | SceneTopology | PlanningTrial


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
    models have none of the three.
    """

    reconstruction: ReconstructionSummary | None
    planning: tuple[FamilySummary, ...]
    planning_success: Interval | None
    scenes: tuple[SceneQuality, ...]
    trials: tuple[PlanningTrial, ...]
    families: Mapping[str, ReconstructionSummary]


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
        raise EvaluationError("path models are evaluated by planning alone", got=str(unit.kind))
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
    families = simulator_of(setting.world).families
    scenes = tuple(row for row in rows if isinstance(row, SceneQuality))
    trials = tuple(row for row in rows if isinstance(row, PlanningTrial))
    present = {trial.family for trial in trials}
    by_family = {family: [scene for scene in scenes if scene.family == family] for family in families.names}
    # Resampling of its own leaves the other intervals as they are in an evaluation without families.
    (own_rng,) = rng.spawn(1)
    uniform = by_family.pop(UNIFORM)
    return SplitResult(
        None if setting.paths else summarise(uniform, rng),
        tuple(summarise_family(family, trials, rng) for family in planned(families) if family in present),
        success_rate(trials) if trials else None,
        scenes,
        trials,
        {family: summarise(mine, own_rng) for family, mine in by_family.items() if mine},
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
    simulator, planner = simulator_of(setting.world), planner_of(setting.world)
    for index in range(unit.first, unit.first + unit.count):
        try:
            problem = simulator.problem(unit.family, unit.split, setting.seed, index)
        except ScenarioError:
            if unit.family == UNIFORM:
                raise
            continue
        for repeat in range(setting.budget.planner_seeds):
            seed = planner_seed(setting.seed, index, repeat)
            rows.append(plan_trial(problem, index, seed, sampler, planner))
        wanted = (
            unit.family == simulator.families.decisive != UNIFORM and index < setting.budget.narrow_scenarios
        )
        if wanted and not sampler.with_ends:
            scene = Scene(_stage(unit, setting), index, unit.family, problem)
            rows.append(reconstruct(scene, sampler, setting.budget.samples))
    return rows


def planner_of(world: World) -> PlannerSettings:
    """The planner of every evaluation in a world, named in the report.

    A limit in iterations makes a run independent of the machine's load, which the limit in time only guards.
    """
    measures = simulator_of(world).measures
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
