"""A validity head's measures on known answers, and through a scene."""

import dataclasses

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.errors import EvaluationError
from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation.measured import flat_metrics, occupancy_table
from services.evaluator.evaluation.units import (
    EVALUATED_SPLITS,
    Budget,
    Kind,
    Setting,
    Unit,
    assemble,
    run_unit,
)
from services.evaluator.measures.occupancy import reliability_diagram, scene_occupancy, summarise_occupancy
from services.evaluator.measures.sample_quality import summarise
from services.evaluator.measures.scenes import Scene, ScoredBundleSampler, Stage, bundle_sampler, reconstruct
from services.planner.samples import BundleSampler
from tests.bundles import tiny_graphs, tiny_spec, write_tiny_bundle
from tests.fakes.uniform_sampler import ScoredUniformSampler

DISCONNECTED = Family.DISCONNECTED
STAGE = Stage(PlanarWorld(TWO_LINK, Camera()), Split.VALIDATION, 5)


def certain(free, confidence=1.0):
    return np.where(free, confidence, 1.0 - confidence)


def test_a_head_that_is_right_and_sure_has_no_error():
    free = np.array([True, False, True, False])
    row = scene_occupancy(certain(free), free, np.array([0.05, -0.05, 1.0, -1.0]), 0.7, 0.1)
    summary = summarise_occupancy([row, row], np.random.default_rng(0))
    assert summary.accuracy.estimate == 1.0
    assert summary.near_accuracy.estimate == 1.0
    assert summary.calibration_error.estimate == pytest.approx(0.0)
    assert summary.acceptance.estimate == pytest.approx(0.7)
    assert summary.reliability == ((0.0, 0.0, 4), (1.0, 1.0, 4))


def test_only_configurations_near_contact_count_for_the_accuracy_there():
    free = np.array([True, True, False, False])
    confidence = np.array([0.9, 0.1, 0.9, 0.1])
    row = scene_occupancy(confidence, free, np.array([0.5, 0.09, -0.09, -0.5]), 1.0, 0.1)
    assert (row.accuracy, row.near_right, row.near) == (0.5, 0, 2)


def test_the_calibration_error_is_the_gap_between_confidence_and_share():
    free = np.arange(100) < 60
    row = scene_occupancy(np.full(100, 0.8), free, np.ones(100), 1.0, 0.1)
    summary = summarise_occupancy([row], np.random.default_rng(0))
    assert summary.calibration_error.estimate == pytest.approx(0.2)
    assert summary.reliability == ((pytest.approx(0.8), pytest.approx(0.6), 100),)
    assert summary.near_accuracy is None


def test_no_scenarios_are_an_error():
    with pytest.raises(EvaluationError):
        summarise_occupancy([], np.random.default_rng(0))


def oracle(scene, threshold=0.5):
    """Uniform samples, scored by the exact checker of the scene."""
    return ScoredUniformSampler(TWO_LINK.space, CollisionChecker(scene.scenario).valid_batch, threshold)


def test_confident_samples_are_as_many_and_all_pass():
    scene = Scene(STAGE, 0)
    quality = reconstruct(scene, oracle(scene), 400)
    assert quality.confident.precision == 1.0
    assert quality.sampler.precision < 0.95
    assert quality.confident.coverage > 0.8
    assert quality.occupancy.accuracy == 1.0
    assert quality.occupancy.acceptance == pytest.approx(quality.sampler.precision, abs=0.06)


def test_a_head_that_lets_nothing_pass_is_judged_without_its_samples():
    scene = Scene(STAGE, 0)
    quality = reconstruct(scene, oracle(scene, 1.5), 50)
    assert quality.confident is None
    assert (quality.occupancy.acceptance, quality.occupancy.accuracy) == (0.0, 1.0)
    summary = summarise([quality], np.random.default_rng(0))
    assert summary.confident is None
    assert summary.occupancy.acceptance.estimate == 0.0


def test_samplers_without_a_head_have_no_such_summary(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle"))
    sampler = bundle_sampler(bundle)
    assert type(sampler) is BundleSampler
    summary = summarise([reconstruct(Scene(STAGE, 0), sampler, 50)], np.random.default_rng(0))
    assert (summary.confident, summary.occupancy) == (None, None)


def test_a_bundle_with_head_and_threshold_is_judged_with_them(tmp_path):
    bundle = scored_bundle(tmp_path / "bundle", 0.3)
    sampler = bundle_sampler(bundle)
    assert isinstance(sampler, ScoredBundleSampler)
    assert sampler.threshold == 0.3
    rows = [reconstruct(Scene(STAGE, index), sampler, 50) for index in range(3)]
    summary = summarise(rows, np.random.default_rng(0))
    assert 0.0 < summary.occupancy.acceptance.estimate <= 1.0
    assert summary.confident.precision.count == 3
    assert len(reliability_diagram(summary.occupancy, "title").axes) == 2


def test_confident_samples_of_a_bundle_are_those_whose_score_reaches_its_threshold(tmp_path):
    scene = Scene(STAGE, 0)
    drawn = bundle_sampler(scored_bundle(tmp_path / "low", 0.0)).sample(scene.image, 200, 5).samples
    sampler = bundle_sampler(scored_bundle(tmp_path / "bundle", 0.5))
    scores = sampler.score(scene.image, drawn)
    threshold = float(np.median(scores))
    found = sampler.sample(scene.image, 200, 5, min_confidence=threshold)
    assert len(found.samples) == 200
    assert (sampler.score(scene.image, found.samples) >= np.float32(threshold)).all()
    assert found.acceptance == pytest.approx(0.5, abs=0.1)


def test_a_head_is_judged_by_family(tmp_path):
    sampler = bundle_sampler(scored_bundle(tmp_path / "bundle", 0.3))
    work = [
        Unit(Kind.RECONSTRUCTION, split, 0, 1, family)
        for split in EVALUATED_SPLITS
        for family in (None, DISCONNECTED)
    ]
    budget = Budget(1, 50, 0, 0, 1, 0, 1, disconnected_scenarios=1)
    setting = Setting(PlanarWorld(TWO_LINK, Camera()), 5, budget)
    evaluation = assemble([run_unit(unit, setting, sampler) for unit in work], setting)
    (row,) = [row for row in evaluation.test.scenes if row.family is DISCONNECTED]
    metrics = flat_metrics(evaluation)
    assert metrics["test_disconnected_head_accuracy"] == row.occupancy.accuracy
    assert metrics["test_disconnected_head_near_accuracy"] == row.occupancy.near_right / row.occupancy.near
    assert metrics["test_disconnected_confident_precision"] == row.confident.precision
    table = occupancy_table(evaluation.test, 0.1)
    assert table[0][2] == "within 0.1 m of contact"
    assert [cells[0] for cells in table] == ["family", "uniform", "disconnected"]
    assert table[2][1].startswith(f"{row.occupancy.accuracy:.4f}")


def scored_bundle(folder, threshold):
    spec = dataclasses.replace(tiny_spec(), confidence_threshold=threshold)
    return Bundle.load(write_bundle(folder, spec, tiny_graphs(spec, validity=True)))
