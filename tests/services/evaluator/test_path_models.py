"""Path models are judged by what a planner gains, with the shipped head's path sampler and a useless one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.problems import Family, draw_problem
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.evaluation import (
    LEARNED_SAMPLES,
    Budget,
    learned_samples,
)
from services.evaluator.job import Request, evaluate_version
from services.evaluator.scenes import bundle_sampler
from services.registry.entities import ModelReference
from services.registry.promotion import decisions
from tests.fakes.registry import FakeRegistry, FakeTracking
from tests.fakes.uniform_sampler import UniformSampler
from training.path_sampler import make_path_bundle

MODEL = "path-sampler"
FEW = Budget(
    scenarios=3,
    samples=100,
    validation_problems=6,
    test_problems=1,
    planner_seeds=1,
    topology_scenarios=1,
    draws=1,
    narrow_scenarios=2,
    disconnected_scenarios=2,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_path_bundle(Bundle.load(PRETRAINED_FOLDER), tmp_path_factory.mktemp("paths") / "bundle")


def evaluated(tmp_path: Path, bundle: Bundle, lines: list[str]):
    tracking = FakeTracking()
    registry = FakeRegistry(tmp_path / "registry", tracking.runs)
    run_id = tracking.start(MODEL, "made").run_id
    registry.register(MODEL, bundle.folder, run_id, bundle.digest, {}, alias="challenger")
    request = Request(ModelReference(MODEL, "challenger"), FEW)
    outcome = evaluate_version(request, tracking, registry, progress=lines.append)
    return outcome, tracking.runs[outcome.run_id], registry


@pytest.mark.slow
def test_the_shipped_heads_path_sampler_is_promoted_for_what_it_saves(made, tmp_path):
    lines = []
    outcome, run, registry = evaluated(tmp_path, made, lines)
    assert outcome.verdict.promoted, outcome.verdict.reasons
    assert registry.by_alias(MODEL, "champion").number == 1
    (decision,) = decisions(registry, MODEL)
    assert set(decision.metrics) == {"planning_success", "narrow_edge_checks_ratio"}
    assert decision.metrics["narrow_edge_checks_ratio"] > 1.0
    assert not any("reconstruction" in line or "topology" in line for line in lines)
    report = run.artifacts["report/evaluation.md"].decode()
    assert "## Planning, validation" in report
    assert "## Reconstruction" not in report
    assert "6 validation and 1 test problems a family" in report
    assert outcome.figures == ()
    assert {"validation/narrow/edge_checks_saved", "test/uniform/success"} <= set(run.history)
    assert {"validation/planning_success", "test/narrow/iterations_saved"} <= set(registry.shown[MODEL, 1][0])
    assert "precision" not in run.history


def test_start_and_goal_reach_the_model(made):
    sampler = bundle_sampler(made)
    assert sampler.with_ends
    assert not UniformSampler(TWO_LINK.space).with_ends
    # Nothing is in the way, so that paths are found.
    image, problem = np.full((48, 48, 3), 255, np.uint8), draw_problem(Family.UNIFORM, Split.DEMO, 0)
    turned = replace(problem, start=problem.goal, goal=problem.start)
    there, back = (learned_samples(one, image, 3, sampler) for one in (problem, turned))
    ends = {"start": problem.start, "goal": problem.goal}
    expected = made.sample(image, LEARNED_SAMPLES, 3, min_confidence=0.0, **ends).samples
    assert np.array_equal(there, expected)
    assert not np.array_equal(there, back)
