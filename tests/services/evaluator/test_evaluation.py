import json
import random
from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.errors import EvaluationError
from cspace.problem import Family
from cspace.robot import THREE_LINK, TWO_LINK
from cspace.scenario import Camera, Split
from services.evaluator.budget import Budget, Kind, Unit, units
from services.evaluator.evaluation import Setting, assemble, planner_seed, run_unit
from services.evaluator.execution import run_here
from services.evaluator.gallery import gallery
from services.evaluator.metrics import flat_metrics
from services.evaluator.report import terminal_table, to_json, to_markdown
from services.evaluator.samplers import PackedBundle, UniformSampler
from services.evaluator.scenes import Scene, Stage
from tests.bundles import write_tiny_bundle

TINY = Budget(
    scenarios=4,
    samples=200,
    validation_problems=2,
    test_problems=1,
    planner_seeds=1,
    topology_scenarios=1,
    draws=2,
)


def setting(robot=TWO_LINK, budget=TINY):
    return Setting(robot, Camera(), 3, budget)


def timeless(evaluation):
    """Everything that a seed fixes; times are not."""
    metrics = flat_metrics(evaluation)
    return {name: value for name, value in metrics.items() if "time" not in name and "seconds" not in name}


@pytest.fixture(scope="module")
def results():
    # Narrow problems take long to draw; the other family goes through the same code.
    work = [unit for unit in units(TINY) if unit.family != Family.NARROW]
    return [run_unit(unit, setting(), UniformSampler(TWO_LINK.space)) for unit in work]


@pytest.fixture(scope="module")
def evaluation(results):
    return assemble(results, setting())


def test_the_order_of_the_results_does_not_matter(results, evaluation):
    shuffled = list(results)
    random.Random(1).shuffle(shuffled)  # noqa: S311 - an order, no secret
    assert timeless(assemble(shuffled, setting())) == timeless(evaluation)


def test_the_size_of_the_units_does_not_matter(results):
    sampler = UniformSampler(TWO_LINK.space)
    whole = run_unit(Unit(Kind.RECONSTRUCTION, Split.TEST, 0, 4), setting(), sampler).rows
    parts = [
        run_unit(Unit(Kind.RECONSTRUCTION, Split.TEST, i, 1), setting(), sampler).rows[0] for i in range(4)
    ]
    assert list(whole) == parts


def test_splits_are_measured_on_their_own_scenarios(evaluation):
    validation, test = evaluation.validation, evaluation.test
    assert len(validation.scenes) == len(test.scenes) == 4
    assert validation.scenes != test.scenes
    assert [len(split.trials) for split in (validation, test)] == [2, 1]


def test_an_evaluation_without_scenarios_is_an_error(results):
    planning = [result for result in results if result.unit.kind == Kind.PLANNING]
    with pytest.raises(EvaluationError):
        assemble(planning, setting())


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
    ):
        assert metrics[f"{name}_low"] <= metrics[f"{name}_high"]
        assert name in metrics
    assert metrics["real_precision"] == 1.0
    assert metrics["uniform_edr"] == 1.0
    assert "test_gs_floor" in metrics


def test_the_json_holds_every_row(evaluation):
    told = json.loads(to_json(evaluation))
    assert len(told["validation"]["scenes"]) == 4
    assert told["test"]["trials"][0]["family"] == "uniform"
    assert told["planner"]["planner"] == "RRT"


def test_the_markdown_names_the_decision_and_every_table(evaluation):
    text = to_markdown(evaluation, "cspace-sampler/4", ["coverage 0.959 is at or above the floor"])
    assert text.startswith("# cspace-sampler/4\n")
    assert "- coverage 0.959 is at or above the floor" in text
    for heading in ("Reconstruction, validation (decides)", "Planning, test (reported only)", "Topology"):
        assert f"## {heading}" in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line.endswith("|") for line in tables)


def test_the_terminal_table_is_aligned(evaluation):
    lines = terminal_table(evaluation).splitlines()
    header = next(index for index, line in enumerate(lines) if line.startswith("samples"))
    column = lines[header].index("precision")
    assert [lines[header + row][column - 2 : column] for row in (1, 2, 3)] == ["  "] * 3
    assert lines[header + 3].startswith("real     1.000")


def test_three_joints_are_evaluated_without_planning_and_with_both_scores():
    budget = replace(TINY, scenarios=2)
    sampler = UniformSampler(THREE_LINK.space)
    work = units(budget, joints=3)
    evaluation = assemble(
        [run_unit(unit, setting(THREE_LINK, budget), sampler) for unit in work], setting(THREE_LINK)
    )
    assert evaluation.validation.planning_success is None
    assert set(evaluation.topology) == {"gs", "gsc_boundary", "gsc_true"}
    assert "planning_success" not in flat_metrics(evaluation)


def test_a_packed_bundle_is_evaluated_in_this_process(tmp_path):
    packed = PackedBundle.pack(Bundle.load(write_tiny_bundle(tmp_path / "bundle")))
    work = [Unit(Kind.RECONSTRUCTION, Split.TEST, 0, 1), Unit(Kind.RECONSTRUCTION, Split.TEST, 1, 1)]
    first, second = run_here(work, setting(), packed)
    assert first.rows[0] != second.rows[0]
    assert next(run_here(work, setting(), packed)).rows == first.rows


def test_planner_seeds_differ_and_are_never_zero():
    seeds = {planner_seed(0, index, repeat) for index in range(50) for repeat in range(3)}
    assert len(seeds) == 150
    assert min(seeds) >= 1
    assert max(seeds) < 2**31


@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK])
def test_the_gallery_has_three_panels_a_scenario(robot, tmp_path):
    stage = Stage(robot, Camera(), Split.TEST, 0)
    figure = gallery([Scene(stage, 0), Scene(stage, 1)], UniformSampler(robot.space), "two scenarios")
    figure.savefig(tmp_path / "gallery.png")
    assert len(figure.axes) == 6
    assert (tmp_path / "gallery.png").stat().st_size > 10_000
    assert "free" in figure.axes[2].get_title()
