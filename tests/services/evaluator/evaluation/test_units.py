import random
from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import EvaluationError
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation.measured import (
    MAX_HEADLINE,
    MAX_METRICS,
    flat_metrics,
    headline,
    run_metrics,
)
from services.evaluator.evaluation.report import terminal_table, to_markdown
from services.evaluator.evaluation.units import (
    QUICK,
    Budget,
    Kind,
    Setting,
    Unit,
    assemble,
    planner_seed,
    run_unit,
    units,
)
from services.evaluator.measures.planning import PlanningTrial
from services.evaluator.measures.scenes import Scene, Stage, reconstruct
from tests.fakes.uniform_sampler import UniformSampler

TINY = Budget(
    scenarios=4,
    samples=200,
    validation_problems=2,
    test_problems=1,
    planner_seeds=1,
    topology_scenarios=1,
    draws=2,
    narrow_scenarios=1,
    disconnected_scenarios=2,
    topology_samples=200,
)
FAMILIES = ["narrow", "disconnected"]
# One whose problems are found soon: drawing them takes longer than all that is measured on them.
SEED = 12


def setting(robot=TWO_LINK, budget=TINY):
    return Setting(PlanarWorld(robot, Camera()), SEED, budget)


def timeless(evaluation):
    """Everything that a seed fixes; times are not."""
    metrics = flat_metrics(evaluation)
    return {name: value for name, value in metrics.items() if "time" not in name and "seconds" not in name}


@pytest.fixture(scope="module")
def results():
    return [run_unit(unit, setting(), UniformSampler(TWO_LINK.space)) for unit in units(setting())]


@pytest.fixture(scope="module")
def evaluation(results):
    return assemble(results, setting())


def test_the_order_of_the_results_does_not_matter(results, evaluation):
    shuffled = list(results)
    random.Random(1).shuffle(shuffled)  # noqa: S311 - an order, no secret
    assert timeless(assemble(shuffled, setting())) == timeless(evaluation)


def test_the_size_of_the_units_does_not_matter(results):
    whole = next(one for one in results if one.unit == Unit(Kind.RECONSTRUCTION, Split.TEST, 0, 4))
    last = run_unit(Unit(Kind.RECONSTRUCTION, Split.TEST, 3, 1), setting(), UniformSampler(TWO_LINK.space))
    assert whole.rows[3:] == last.rows


def test_splits_are_measured_on_their_own_scenarios(evaluation):
    validation, test = evaluation.validation, evaluation.test
    assert len(validation.scenes) == len(test.scenes) == 7
    assert not set(validation.scenes) & set(test.scenes)
    assert [len(split.trials) for split in (validation, test)] == [4, 2]


def test_families_are_summarised_each_for_itself(evaluation):
    for split in (evaluation.validation, evaluation.test):
        assert list(split.families) == FAMILIES
        assert sorted((row.family, row.index) for row in split.scenes) == [
            *(("disconnected", 0), ("disconnected", 1), ("narrow", 0)),
            *(("uniform", index) for index in range(4)),
        ]
        assert [split.families[family].sampler.precision.count for family in FAMILIES] == [1, 2]
        assert split.reconstruction.sampler.precision.count == 4
        (narrow,) = [row for row in split.scenes if row.family == Family.NARROW]
        assert split.families[Family.NARROW].sampler.precision_minimum == narrow.sampler.precision
    metrics = flat_metrics(evaluation)
    disconnected = [row for row in evaluation.test.scenes if row.family == Family.DISCONNECTED]
    assert metrics["test_disconnected_coverage"] == pytest.approx(
        np.mean([row.sampler.coverage for row in disconnected])
    )
    assert metrics["test_narrow_real_precision"] == 1.0


def test_families_change_no_number_of_the_uniform_scenarios(results, evaluation):
    kept = {
        None: object,
        Family.DISCONNECTED: (),
        Family.NARROW: PlanningTrial,
        Family.UNIFORM: PlanningTrial,
    }
    without = [
        replace(result, rows=tuple(row for row in result.rows if isinstance(row, kept[result.unit.family])))
        for result in results
    ]
    plain = assemble(without, setting())
    assert not plain.test.families
    assert timeless(plain).items() <= timeless(evaluation).items()
    assert "by family" not in terminal_table(plain)


def test_a_narrow_problem_is_planned_and_its_scenario_sampled(results):
    unit = next(
        result
        for result in results
        if (result.unit.kind, result.unit.family, result.unit.split)
        == (Kind.PLANNING, Family.NARROW, Split.VALIDATION)
    )
    names = [type(row).__name__ for row in unit.rows]
    assert names == ["PlanningTrial", "SceneQuality", "PlanningTrial"]
    stage = Stage(PlanarWorld(TWO_LINK, Camera()), Split.VALIDATION, SEED)
    alone = reconstruct(Scene(stage, 0, Family.NARROW), UniformSampler(TWO_LINK.space), TINY.samples)
    assert unit.rows[1] == alone


def test_an_evaluation_without_scenarios_is_an_error(results):
    planning = [result for result in results if result.unit.kind == Kind.PLANNING]
    with pytest.raises(EvaluationError):
        assemble(planning, setting())


def test_a_run_has_few_metrics_by_group_and_a_headline_fewer(evaluation):
    metrics, first = run_metrics(evaluation), headline(evaluation)
    assert first.items() <= metrics.items()
    assert (len(first) <= MAX_HEADLINE, len(metrics) <= MAX_METRICS) == (True, True)
    assert {name.partition("/")[0] for name in metrics} == {"validation", "test", "cost"}
    flat = flat_metrics(evaluation)
    assert metrics["validation/narrow/edge_checks_saved"] == flat["narrow_edge_checks_ratio"]
    assert metrics["test/uniform_precision"] == flat["test_uniform_precision"]
    assert metrics["test/topology/gs"] == flat["test_gs"]


def test_metrics_are_finite_and_carry_their_limits(evaluation):
    metrics = flat_metrics(evaluation)
    assert all(np.isfinite(value) for value in metrics.values())
    for name in (
        "precision",
        "coverage",
        "edr",
        "test_uniform_coverage",
        "planning_success",
        "test_gsc_true",
        "knn_precision",
        "test_real_knn_recall",
        "narrow_uniform_knn_precision",
    ):
        assert metrics[f"{name}_low"] <= metrics[f"{name}_high"]
        assert name in metrics
    assert metrics["real_precision"] == 1.0
    assert metrics["uniform_edr"] == 1.0
    assert "test_gs_floor" in metrics
    gated = simulator_of(PlanarWorld()).measures
    assert {*gated.margins, *gated.path_margins} <= metrics.keys()


def test_the_markdown_names_the_decision_and_every_table(evaluation):
    text = to_markdown(evaluation, "cspace-sampler/4", ["coverage 0.959 is at or above the floor"])
    assert text.startswith("# cspace-sampler/4\n")
    assert "- coverage 0.959 is at or above the floor" in text
    for heading in (
        "Reconstruction, validation (decides)",
        "Reconstruction by family, validation (reported only)",
        "Planning, test (reported only)",
        "Topology",
    ):
        assert f"## {heading}" in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line.endswith("|") for line in tables)


def test_the_terminal_table_is_aligned(evaluation):
    lines = terminal_table(evaluation).splitlines()
    header = next(index for index, line in enumerate(lines) if line.startswith("samples"))
    column = lines[header].index("precision")
    assert [lines[header + row][column - 2 : column] for row in (1, 2, 3)] == ["  "] * 3
    assert lines[header + 3].startswith("real     1.000")
    families = lines.index("by family, test")
    assert [line.split()[:3] for line in lines[families + 5 : families + 7]] == [
        ["narrow", "1", "sampler"],
        ["narrow", "1", "uniform"],
    ]


@pytest.mark.slow
def test_three_joints_are_evaluated_with_planning_and_with_both_scores():
    budget = replace(TINY, scenarios=2, disconnected_scenarios=0)
    sampler = UniformSampler(THREE_LINK.space)
    work = units(setting(THREE_LINK, budget))
    # Their grid tells of no narrow passages.
    assert {unit.family for unit in units(setting(THREE_LINK, QUICK))} == {None, "uniform", "disconnected"}
    evaluation = assemble(
        [run_unit(unit, setting(THREE_LINK, budget), sampler) for unit in work], setting(THREE_LINK)
    )
    assert [summary.family for summary in evaluation.validation.planning] == ["uniform"]
    assert set(evaluation.topology) == {"gs", "gsc_boundary", "gsc_true"}
    assert "planning_success" in flat_metrics(evaluation)


def test_planner_seeds_differ_and_are_never_zero():
    seeds = {planner_seed(0, index, repeat) for index in range(50) for repeat in range(3)}
    assert len(seeds) == 150
    assert min(seeds) >= 1
    assert max(seeds) < 2**31
