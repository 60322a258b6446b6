"""An evaluation: units of work, measured one by one into one long table, and the estimates made of it."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cspace.errors import EvaluationError, ScenarioError
from cspace.query import SampleQuery
from cspace.simulator import UNIFORM, Families, Problem, Split
from cspace.world import World
from cspace.worlds import simulator_of
from services.evaluator.metrics import Head, Metric, Run, Task, measured, metrics_of
from services.evaluator.metrics.geometry_score import POINTS, Clouds
from services.evaluator.scenes import SAMPLES, Scene, Stage, unfiltered
from services.evaluator.statistics import Interval, summary_rng
from services.planner.ompl_planner import solve
from services.planner.planning import between_ends
from services.planner.result import PlannerSettings
from services.planner.samples import SampleSource

EVALUATED_SPLITS = (Split.VALIDATION, Split.TEST)
LEARNED_SAMPLES = 300
UNIFORM_SHARE = 0.3
# Uniform configurations on which a validity head is evaluated.
HEAD_SAMPLES = 2000
# The stream of the confident samples, apart from those of the other measurements.
CONFIDENT_STREAM = 20


class Row(NamedTuple):
    """One value in a scenario or problem.

    ``sampler`` is ``sampler`` as drawn (in planning ``learned``), ``confident`` as served, ``uniform`` or
    ``real``; empty for the head and for comparisons of samplers. ``part`` counts the values of a metric.
    """

    task: str
    family: str
    number: int
    seed: int
    sampler: str
    metric: str
    part: int
    value: float


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is evaluated: scenarios per split, problems per family, runs per problem.

    GS and GS-C take scenarios of the test split, with so many draws of landmarks. ``narrow_scenarios`` are
    those of the decisive family's first problems, ``disconnected_scenarios`` of each unsolvable family.
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
    """Neighbouring scenarios or problems of a family."""

    task: Task
    split: Split
    first: int
    count: int
    family: str = UNIFORM


@dataclass(frozen=True, slots=True)
class Setting:
    """What an evaluation is about: robot, camera, seed, how much, and whether it is of a path model."""

    world: World
    seed: int
    budget: Budget
    paths: bool = False


@dataclass(frozen=True, slots=True)
class UnitResult:
    """The rows of one unit of work, and the time that it took."""

    unit: Unit
    rows: list[Row]
    seconds: float


def units(setting: Setting) -> list[Unit]:
    """All units of an evaluation, the long ones first, so that workers end together.

    Path models are evaluated by planning alone. Of given scenes, no more are taken than there are.
    """
    budget, simulator = setting.budget, simulator_of(setting.world)

    def cut(task: Task, split: Split, count: int, size: int, family: str = UNIFORM) -> list[Unit]:
        known = simulator.count(split)
        limited = known is not None and family == UNIFORM and task != Task.PLANNING
        total = min(count, known) if limited and known is not None else count
        return [Unit(task, split, n, min(size, total - n), family) for n in range(0, total, size)]

    problems = {Split.VALIDATION: budget.validation_problems, Split.TEST: budget.test_problems}
    both = EVALUATED_SPLITS
    work: list[Unit] = []
    for family in planned(simulator.families):
        work += [one for split in both for one in cut(Task.PLANNING, split, problems[split], 5, family)]
    if setting.paths:
        return work
    for family in simulator.families.unsolvable:
        count = budget.disconnected_scenarios
        work += [one for split in both for one in cut(Task.RECONSTRUCTION, split, count, 5, family)]
    work += cut(Task.TOPOLOGY, Split.TEST, budget.topology_scenarios, 1)
    work += [one for split in both for one in cut(Task.RECONSTRUCTION, split, budget.scenarios, 15)]
    return work


def deciding(work: Iterable[Unit]) -> list[Unit]:
    """The units that decide, by which a rival is measured as well."""
    return [
        one
        for one in work
        if one.split is Split.VALIDATION and (one.task is Task.PLANNING or one.family == UNIFORM)
    ]


def planned(families: Families) -> tuple[str, ...]:
    """The families that a planner is asked to solve, the decisive one first."""
    return tuple(dict.fromkeys((families.decisive, *families.solvable)))


def run_unit(unit: Unit, setting: Setting, sampler: SampleSource) -> UnitResult:
    """Measure one unit of work; its rows depend on nothing else."""
    began = time.perf_counter()
    if sampler.with_ends and unit.task is not Task.PLANNING:
        raise EvaluationError("path models are evaluated by planning alone", got=str(unit.task))
    tasks = {Task.PLANNING: _planning, Task.RECONSTRUCTION: _reconstruction, Task.TOPOLOGY: _topology}
    stage = Stage(setting.world, unit.split, setting.seed)
    rows = [
        row
        for index in range(unit.first, unit.first + unit.count)
        for row in tasks[unit.task](Scene(stage, index, unit.family), setting, sampler)
    ]
    return UnitResult(unit, rows, time.perf_counter() - began)


def _rows(task: Task, given: Any, family: str, index: int, seed: int = 0, sampler: str = "") -> Iterator[Row]:
    for name, part, value in measured(task, given):
        yield Row(task, family, index, seed, sampler, name, part, value)


def reconstruct(scene: Scene, sampler: SampleSource, samples: int = SAMPLES) -> list[Row]:
    """The sampler, uniform samples and further real samples against the same held-out free configurations.

    With a validity head also the head itself, and the samples that it accepts, unless it accepts too few.
    """
    groups: dict[str, NDArray[np.floating[Any]]] = {
        "sampler": unfiltered(sampler, scene.image, samples, scene.sampler_seed()),
        "uniform": scene.space.sample_uniform(scene.rng(1), samples),
        "real": scene.free(samples, scene.rng(2)),
    }
    rows: list[Row] = []
    if sampler.threshold is not None:
        query = SampleQuery(samples, scene.sampler_seed(CONFIDENT_STREAM), min_confidence=sampler.threshold)
        confident = sampler.answer(scene.image, query)
        if len(confident.samples) == samples:
            groups["confident"] = confident.samples
        rows += _rows(Task.HEAD, _head(scene, sampler, confident.acceptance), scene.family, scene.index)
    return [*rows, *measure_samples(scene, groups, samples)]


def measure_samples(
    scene: Scene, groups: Mapping[str, NDArray[np.floating[Any]]], held_out: int = SAMPLES
) -> Iterator[Row]:
    """Samples by name against the same held-out free configurations."""
    real = scene.free(held_out, scene.rng(0))
    for name, group in groups.items():
        given = scene.group(group, real)
        yield from _rows(Task.RECONSTRUCTION, given, scene.family, scene.index, sampler=name)


def _head(scene: Scene, sampler: SampleSource, acceptance: float | None) -> Head:
    tried = scene.space.to_float32(scene.space.sample_uniform(scene.rng(3), HEAD_SAMPLES))
    checker, near_contact_m = scene.checker, scene.measures.near_contact_m
    confidence, free = sampler.score(scene.image, tried), checker.valid_batch(tried)
    return Head(confidence, free, checker.clearance(tried), float(acceptance or 0.0), near_contact_m)


def _reconstruction(scene: Scene, setting: Setting, sampler: SampleSource) -> list[Row]:
    try:
        return reconstruct(scene, sampler, setting.budget.samples)
    except ScenarioError:
        # Not all scenes have problems of every family.
        if scene.family == UNIFORM:
            raise
        return []


def _topology(scene: Scene, setting: Setting, sampler: SampleSource) -> Iterator[Row]:
    return measure_topology(scene, sampler, setting.budget.draws, setting.budget.topology_samples)


def measure_topology(scene: Scene, sampler: SampleSource, draws: int, samples: int = POINTS) -> Iterator[Row]:
    """GS and GS-C of a sampler."""
    clouds = sample_clouds(scene, sampler, draws, samples)
    return _rows(Task.TOPOLOGY, clouds, scene.family, scene.index)


def sample_clouds(scene: Scene, sampler: SampleSource, draws: int, count: int = POINTS) -> Clouds:
    """Clouds of ``count`` points; ``draws`` is the number of landmark draws per cloud and turn."""
    generated = unfiltered(sampler, scene.image, count, int(scene.rng(11).integers(0, 2**63)))
    real, again = (scene.free(count, scene.rng(stream)) for stream in (3, 4))
    return Clouds(real, generated, again, scene.space, draws, scene.rng, scene.collisions)


def _planning(scene: Scene, setting: Setting, sampler: SampleSource) -> Iterator[Row]:
    stage, index, family, budget = scene.stage, scene.index, scene.family, setting.budget
    simulator = simulator_of(setting.world)
    try:
        problem = simulator.problem(family, stage.split, setting.seed, index)
    except ScenarioError:
        if family == UNIFORM:
            raise
        return
    for repeat in range(budget.planner_seeds):
        seed = planner_seed(setting.seed, index, repeat)
        for name, run in plan_problem(problem, seed, sampler, planner_of(setting.world)).items():
            yield from _rows(Task.PLANNING, run, family, index, seed, name)
    is_shown = family == simulator.families.decisive != UNIFORM and index < budget.narrow_scenarios
    if is_shown and not sampler.with_ends:
        yield from reconstruct(Scene(stage, index, family, problem), sampler, budget.samples)


def plan_problem(
    problem: Problem, seed: int, sampler: SampleSource, settings: PlannerSettings
) -> dict[str, Run]:
    """Solve one problem with each kind of samples under one seed.

    ``confident`` samples are those that a validity head accepts, of path models without one further ones.
    """
    seeded = replace(settings, seed=seed)
    image = simulator_of(problem.scenario.world).render(problem.scenario)
    learned = learned_samples(problem, image, seed, sampler)
    groups: dict[str, NDArray[np.float32] | None] = {"uniform": None, "learned": learned}
    if sampler.threshold is not None or sampler.with_ends:
        accepted = learned_samples(problem, image, seed, sampler, sampler.threshold or 0.0)
        if len(accepted) == LEARNED_SAMPLES:
            groups["confident"] = accepted
    found = {name: solve(problem, seeded, samples, UNIFORM_SHARE) for name, samples in groups.items()}
    return {name: Run(one.solved, one.iterations, one.edge_checks) for name, one in found.items()}


def learned_samples(
    problem: Problem, image: NDArray[np.uint8], seed: int, sampler: SampleSource, min_confidence: float = 0.0
) -> NDArray[np.float32]:
    """The samples (n, d) rad for a run on a problem, given its picture; n is less where too few pass."""
    query = SampleQuery(LEARNED_SAMPLES, seed, min_confidence=min_confidence)
    return sampler.answer(image, between_ends(query, problem) if sampler.with_ends else query).samples


def planner_of(world: World) -> PlannerSettings:
    """The planner of every evaluation in a world.

    A limit in iterations makes a run independent of the machine's load, which the limit in time only guards.
    """
    measures = simulator_of(world).measures
    return PlannerSettings("RRT", measures.range_rad, measures.resolution_rad, max_iterations=1000)


def planner_seed(seed: int, index: int, repeat: int) -> int:
    """The seed of one run, in 1...2^31 - 1; OMPL takes no zero."""
    state = np.random.SeedSequence(entropy=seed, spawn_key=(98, index, repeat)).generate_state(1)
    return 1 + int(state[0]) % (2**31 - 1)


VALIDATION, TEST = "validation", "test"
MAX_HEADLINE, MAX_METRICS = 12, 60
_PREFIXES = {"sampler": "", "learned": "", "confident": "served_", "uniform": "uniform_", "": ""}
_HEADLINE = ("precision", "coverage", "edr", "served_precision", "served_coverage", "planning_success")
_SCENE = ["family", "number", "seed"]
ESTIMATE_COLUMNS = ["task", "split", "family", "sampler", "measure", "value", "low", "high", "n"]


def table_of(results: Sequence[UnitResult], model: str) -> pd.DataFrame:
    """The rows of a model as a table, in an order that does not depend on that of the results."""
    rows = [(model, str(one.unit.split), *row) for one in results for row in one.rows]
    table = pd.DataFrame(rows, columns=["model", "split", *Row._fields])
    return table.sort_values(["split", "task", "sampler", *_SCENE], kind="stable", ignore_index=True)


@dataclass(frozen=True)
class Evaluation:
    """The values of a model and of its rivals. Validation decides, test is reported."""

    setting: Setting
    model: str
    table: pd.DataFrame
    cpu_seconds: float

    def select(self, split: str, task: Task, model: str | None = None) -> pd.DataFrame:
        """The rows of a split and task, by default of the evaluated model."""
        table = self.table
        return table[
            (table["split"] == split) & (table["task"] == task) & (table["model"] == (model or self.model))
        ]

    @cached_property
    def estimates(self) -> pd.DataFrame:
        """Every estimate of the model, its name in MLflow or an empty one, and whether it is a main one."""
        rows = [
            row
            for split in EVALUATED_SPLITS
            for task in Task
            for row in _estimates(self.select(split, task), str(split), task, self.setting)
        ]
        return pd.DataFrame(rows, columns=[*ESTIMATE_COLUMNS, "log_name", "main"]).astype({"n": "Int64"})

    def estimate(self, measure: str, sampler: str, family: str, split: str = VALIDATION) -> Interval | None:
        """One estimate of samples or planning; None where it was not made."""
        of = pd.Series({"split": split, "family": family, "sampler": sampler, "measure": measure})
        found = self.estimates[(self.estimates[of.index] == of).all(axis=1)]
        if found.empty:
            return None
        value, low, high, count = found.iloc[0][["value", "low", "high", "n"]]
        return Interval(float(value), float(low), float(high), int(count))


def estimates_of(
    rows: Sequence[Row], seed: int, task: Task = Task.RECONSTRUCTION
) -> dict[tuple[str, str], Interval]:
    """Estimates over uniform scenes, by sampler and measure."""
    table = pd.DataFrame(rows, columns=list(Row._fields))
    table = table[(table["task"] == task) & (table["family"] == UNIFORM)]
    found = _intervals(table, task, seed, UNIFORM)
    return {(sampler, measure): interval for sampler, _, measure, _, interval in found}


def _estimates(rows: pd.DataFrame, split: str, task: Task, setting: Setting) -> Iterator[tuple[object, ...]]:
    families = list(dict.fromkeys([*simulator_of(setting.world).families.names, *rows["family"]]))
    groups = [(family, rows[rows["family"] == family]) for family in families]
    if task is Task.PLANNING:
        # The success over all problems.
        groups.insert(0, ("", rows[rows["metric"] == "success"]))
    for family, mine in groups:
        for sampler, one, measure, main, interval in _intervals(mine, task, setting.seed, split, family):
            name = log_name(one, setting.world, split, family, sampler, measure) if main else ""
            limits = (interval.estimate, interval.low, interval.high, interval.count)
            yield (str(task), split, family, sampler, measure, *limits, name, main)


def _intervals(
    rows: pd.DataFrame, task: Task, seed: int, *use: str
) -> Iterator[tuple[str, Metric, str, bool, Interval]]:
    """Sampler, metric, measure, whether it is the metric's main one, and the estimate."""
    for one in metrics_of(task):
        values = {
            str(sampler): group.pivot(index=_SCENE, columns="part", values="value").to_numpy()
            for sampler, group in rows[rows["metric"] == one.name].groupby("sampler")
        }
        everywhere = max(map(len, values.values()), default=0)
        for sampler, found in values.items():
            # A sampler that is missing in some scene is not comparable.
            if len(found) == everywhere:
                rng = summary_rng(seed, task, *use, sampler, one.name)
                made = one.estimates(found, values.get("uniform", found), rng)
                for place, (measure, interval) in enumerate(made.items()):
                    yield sampler, one, measure, place == 0, interval


def log_name(one: Metric, world: World, split: str, family: str, sampler: str, measure: str) -> str:
    """The name of an estimate in MLflow, grouped by the part before ``/``; empty where it is not logged."""
    # Arms have many families, of which the decisive one's costs alone are logged.
    elsewhere = family not in ("", simulator_of(world).families.decisive)
    if sampler not in one.logged or (one.task is Task.PLANNING and elsewhere and one.name != "success"):
        return ""
    name = f"{_PREFIXES[sampler]}{measure}".replace("_ratio", "_saved")
    match one.task:
        case Task.PLANNING:
            return f"{split}/{family}/{name}" if family else f"{split}/planning_{name}"
        case Task.TOPOLOGY:
            return f"{split}/topology/{name}"
        case Task.HEAD:
            return f"{split}/head_{name}" if family == UNIFORM else ""
    if family == UNIFORM:
        return f"{split}/{name}"
    return f"{split}/{family}/{name}" if one.by_family and sampler != "uniform" else ""


def run_metrics(evaluation: Evaluation) -> dict[str, float]:
    """Metrics for an evaluation's page in MLflow, at most :data:`MAX_METRICS`."""
    logged = evaluation.estimates[evaluation.estimates["log_name"] != ""]
    return dict(zip(logged["log_name"], logged["value"], strict=True)) | {
        "cost/cpu_s": evaluation.cpu_seconds
    }


def headline(evaluation: Evaluation) -> dict[str, float]:
    """At most :data:`MAX_HEADLINE` metrics by which versions are chosen.

    Path models have those of the decisive family.
    """
    setting = evaluation.setting
    decisive = simulator_of(setting.world).families.decisive
    return {
        name: value
        for name, value in run_metrics(evaluation).items()
        if name.partition("/")[2] in _HEADLINE or (setting.paths and name.split("/")[1] == decisive)
    }
