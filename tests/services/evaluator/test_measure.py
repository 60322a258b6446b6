"""Scenes and units of work: what is sampled where, determinism, and measures with and without a head."""

import dataclasses
import random

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.errors import BundleIntegrityError
from cspace.simulator import Problem, Split
from cspace.worlds import examples, simulator_of
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import Family, draw_problem
from cspace.worlds.planar.world import Disc, PlanarWorld, Scenario
from services.evaluator.evaluation import (
    EVALUATED_SPLITS,
    MAX_HEADLINE,
    MAX_METRICS,
    QUICK,
    Budget,
    Evaluation,
    Row,
    Setting,
    Unit,
    UnitResult,
    estimates_of,
    headline,
    plan_problem,
    planner_of,
    reconstruct,
    run_metrics,
    run_unit,
    table_of,
    units,
)
from services.evaluator.gate import gated_metrics
from services.evaluator.metrics import Task, metrics_of
from services.evaluator.scenes import PackedBundle, Scene, Stage, bundle_sampler, unfiltered
from services.planner.samples import BundleSampler
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle
from tests.fakes.uniform_sampler import ScoredUniformSampler, UniformSampler
from tests.scenarios import random_scenarios

STAGE = Stage(PlanarWorld(TWO_LINK, Camera()), Split.VALIDATION, 5)
TINY = Budget(4, 200, 2, 1, 1, 1, 2, narrow_scenarios=1, disconnected_scenarios=2, topology_samples=200)
# One whose problems are found soon: drawing them takes longer than all that is measured on them.
SETTING = Setting(PlanarWorld(TWO_LINK, Camera()), 12, TINY)
UNIFORM = UniformSampler(TWO_LINK.space)


@pytest.fixture(scope="module")
def results():
    return [run_unit(unit, SETTING, UNIFORM) for unit in units(SETTING)]


def evaluation_of(results, setting=SETTING):
    return Evaluation(setting, "m/1", table_of(results, "m/1"), 1.0)


def test_neither_order_nor_size_of_the_units_matters(results):
    shuffled = list(results)
    random.Random(1).shuffle(shuffled)  # noqa: S311 - an order, no secret
    assert evaluation_of(shuffled).estimates.equals(evaluation_of(results).estimates)
    whole = next(one for one in results if one.unit == Unit(Task.RECONSTRUCTION, Split.TEST, 0, 4))
    last = run_unit(Unit(Task.RECONSTRUCTION, Split.TEST, 3, 1), SETTING, UNIFORM)
    assert [row for row in whole.rows if row.number == 3] == last.rows


def test_units_cover_every_scenario_and_problem_once():
    work = units(Setting(PlanarWorld(), 0, QUICK))
    seen = {(one.task, one.split, one.family, one.first + k) for one in work for k in range(one.count)}
    problems = 2 * (QUICK.validation_problems + QUICK.test_problems)
    scenarios = 2 * (QUICK.scenarios + QUICK.disconnected_scenarios)
    assert len(seen) == sum(one.count for one in work) == scenarios + QUICK.topology_scenarios + problems


def test_families_are_estimated_each_for_itself_and_change_no_uniform_number(results):
    found = evaluation_of(results)
    counts = {
        family: found.estimate("precision", "sampler", family, "test").count
        for family in ("uniform", "narrow", "disconnected")
    }
    assert counts == {"uniform": 4, "narrow": 1, "disconnected": 2}
    assert found.estimate("precision", "real", "narrow").estimate == 1.0
    plain = evaluation_of([one for one in results if one.unit.family == Family.UNIFORM])
    assert plain.estimate("precision", "real", "narrow") is None
    for sampler in ("sampler", "uniform", "real"):
        assert plain.estimate("edr", sampler, "uniform") == found.estimate("edr", sampler, "uniform")


def test_a_run_has_few_metrics_by_group_and_a_headline_fewer(results):
    found = evaluation_of(results)
    logged, first = run_metrics(found), headline(found)
    assert first.items() <= logged.items()
    assert (len(first) <= MAX_HEADLINE, len(logged) <= MAX_METRICS) == (True, True)
    assert {name.partition("/")[0] for name in logged} == {"validation", "test", "cost"}
    assert {
        "validation/precision",
        "validation/edr",
        "test/uniform_precision",
        "test/narrow/precision",
        "validation/narrow/edge_checks_saved",
        "test/uniform/success",
        "validation/planning_success",
        "test/topology/gsc_true",
    } <= logged.keys()
    assert np.isfinite([*logged.values()]).all()
    assert set(gated_metrics(found)) == set(simulator_of(PlanarWorld()).measures.margins)


def test_an_evaluation_of_an_arm_has_no_more_metrics():
    world, parts = (
        examples()["panda"],
        {"near": 2, "calibration": 45, "precision": 1, "coverage": 1, "energy": 1},
    )
    given = {
        Task.RECONSTRUCTION: (["uniform"], ["sampler", "confident", "uniform", "real"]),
        Task.HEAD: (["uniform"], [""]),
        Task.PLANNING: (simulator_of(world).families.names, ["learned", "uniform"]),
        Task.TOPOLOGY: (["uniform"], [""]),
    }
    rows = [
        Row(task, family, number, 0, sampler, one.name, part, 1.0)
        for task, (families, samplers) in given.items()
        for family in families
        for sampler in samplers
        for one in metrics_of(task)
        for number in range(2)
        for part in range(parts.get(one.name, 1 if one.name == "success" else 2))
    ]
    results = [UnitResult(Unit(Task.PLANNING, split, 0, 1), rows, 1.0) for split in EVALUATED_SPLITS]
    logged = run_metrics(evaluation_of(results, Setting(world, 0, TINY)))
    assert {"validation/shelf/edge_checks_saved", "test/clutter/success", "test/precision"} <= logged.keys()
    assert len(logged) <= MAX_METRICS


def test_scenes_are_the_split_s_scenarios_and_those_of_a_family_its_problems():
    assert [Scene(STAGE, index).scenario for index in range(3)] == random_scenarios(Split.VALIDATION, 5, 3)
    camera = Camera(pixels=32)
    scene = Scene(dataclasses.replace(STAGE, world=PlanarWorld(TWO_LINK, camera)), 1, Family.DISCONNECTED)
    expected = draw_problem(Family.DISCONNECTED, Split.VALIDATION, 5, 1)
    assert scene.scenario == dataclasses.replace(expected.scenario, camera=camera)


def values(rows, sampler):
    return {row.metric: row.value for row in rows if row.sampler == sampler}


def test_uniform_samples_score_as_uniform_and_real_ones_as_real():
    rows = reconstruct(Scene(STAGE, 0), UNIFORM, samples=300)
    sampler, uniform, real = (values(rows, name) for name in ("sampler", "uniform", "real"))
    assert real["precision"] == 1.0
    assert sampler["precision"] == pytest.approx(uniform["precision"], abs=0.1)
    assert abs(real["energy"]) < 0.3 * uniform["energy"]


def oracle(scene, threshold=0.5):
    """Uniform samples, scored by the exact checker of the scene."""
    return ScoredUniformSampler(TWO_LINK.space, CollisionChecker(scene.scenario).valid_batch, threshold)


def test_confident_samples_are_as_many_and_all_pass_unless_too_few_do():
    scene = Scene(STAGE, 0)
    rows = reconstruct(scene, oracle(scene), 400)
    assert values(rows, "confident")["precision"] == 1.0
    drawn, head = values(rows, "sampler"), values(rows, "")
    assert drawn["precision"] < 0.95
    assert head["accuracy"] == 1.0
    assert head["acceptance"] == pytest.approx(drawn["precision"], abs=0.06)
    rows = reconstruct(scene, oracle(scene, 1.5), 50)
    assert values(rows, "confident") == {}
    assert values(rows, "")["acceptance"] == 0.0


def test_a_bundle_with_head_and_threshold_is_measured_with_them(tmp_path):
    spec = dataclasses.replace(tiny_spec(), confidence_threshold=0.3)
    scored = bundle_sampler(Bundle.load(write_bundle(tmp_path / "a", spec, tiny_graphs(spec, validity=True))))
    rows = [row for index in range(3) for row in reconstruct(Scene(STAGE, index), scored, 50)]
    assert estimates_of(rows, 0)["confident", "precision"].count == 3
    assert 0.0 < estimates_of(rows, 0, Task.HEAD)["", "acceptance"].estimate <= 1.0
    plain = bundle_sampler(Bundle.load(write_tiny_bundle(tmp_path / "b")))
    assert type(plain) is BundleSampler
    assert {row.sampler for row in reconstruct(Scene(STAGE, 0), plain, 50)} == {"sampler", "uniform", "real"}


def test_a_packed_bundle_arrives_as_it_was_and_is_verified(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    packed = PackedBundle.pack(bundle)
    arrived = packed.load()
    assert (arrived.digest, arrived.folder.exists()) == (bundle.digest, False)
    drawn = [unfiltered(BundleSampler(one), picture(), 9, 3) for one in (arrived, bundle)]
    np.testing.assert_array_equal(*drawn)
    with pytest.raises(BundleIntegrityError):
        PackedBundle(packed.digest, packed.files | {"generator.onnx": b"other"}).load()


def test_a_head_adds_a_run_with_samples_that_pass_where_there_are_enough():
    scenario = Scenario(TWO_LINK, (Disc(0.0, 3.0),))
    problem = Problem(scenario, np.array([0.0, 0.0]), np.array([-3.0, 0.0]), Family.UNIFORM, 0.1)

    def planned(threshold):
        head = ScoredUniformSampler(TWO_LINK.space, lambda q: q[:, 0] < 0.0, threshold)
        return plan_problem(problem, 77, head, planner_of(PlanarWorld()))

    runs = planned(0.5)
    assert list(runs) == ["uniform", "learned", "confident"]
    assert runs["uniform"].success
    assert "confident" not in planned(2.0)
