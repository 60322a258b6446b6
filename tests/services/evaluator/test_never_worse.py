"""Promotion never makes serving worse: the shipped model and worsened copies of it as candidates."""

from dataclasses import replace

import pytest

from cspace.bundle import Bundle
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.job import Budget, evaluate_version, make_request
from services.names import ALIAS_CHAMPION, MODEL_NAME
from tests.fakes.registry import FakeRegistry, FakeTracking
from tests.worsened import copy_of_shipped

FEW, FEWER = Budget(16, 300, 0, 0, 1, 0, 1), Budget(6, 200, 0, 0, 1, 0, 1)


@pytest.fixture
def evaluate(tmp_path, verified_here):
    """Registers a bundle as a model's next version and evaluates it; the outcome."""
    tracking = FakeTracking()
    registry = FakeRegistry(tmp_path / "registry", tracking.runs)

    def run(bundle, *, shipped=PRETRAINED_FOLDER, lines=None, budget=FEW):
        run_id = tracking.start(MODEL_NAME, "cluster-train").run_id
        version = registry.register(MODEL_NAME, bundle.folder, run_id, bundle.digest, {})
        request = replace(make_request(str(version), shipped=shipped), budget=budget)
        shown = [] if lines is None else lines
        outcome = evaluate_version(request, tracking, registry, progress=shown.append)
        if outcome.verdict.promoted:
            assert registry.by_alias(MODEL_NAME, ALIAS_CHAMPION).number == version.number
        report = tracking.runs[outcome.run_id].artifacts["report/evaluation.md"].decode()
        assert report.count("### Beside") == len(outcome.verdict.bar.comparisons)
        return outcome

    return run


def words(outcome, beginning):
    (found,) = [reason for reason in outcome.verdict.reasons if reason.startswith(beginning)]
    return found


@pytest.mark.slow
def test_a_first_version_that_serves_worse_than_the_shipped_model_is_refused(evaluate, tmp_path):
    # The case: more precise than uniform samples by far, and less than what is served without it.
    lines = []
    outcome = evaluate(copy_of_shipped(tmp_path / "bundle", confidence_threshold=0.0), lines=lines)
    assert not outcome.verdict.promoted
    worse = words(outcome, "worse than the shipped model beyond the interval: ")
    assert "precision as served 0.9" in worse
    assert "better than the shipped model beyond the interval: in nothing" in outcome.verdict.reasons
    assert "measuring the shipped model, on the same scenes" in lines


@pytest.mark.slow
def test_noise_is_found_in_what_is_drawn_although_the_head_hides_it_from_what_is_served(evaluate, tmp_path):
    outcome = evaluate(copy_of_shipped(tmp_path / "bundle", noise=0.1))
    assert not outcome.verdict.promoted
    assert "precision 0.9" in words(outcome, "worse than the shipped model beyond the interval: ")


def test_the_option_leaves_the_shipped_model_out_and_the_reasons_say_so(evaluate, tmp_path):
    outcome = evaluate(copy_of_shipped(tmp_path / "bundle", noise=0.1), shipped=None, budget=FEWER)
    assert outcome.verdict.promoted
    assert "not compared with the shipped model, as requested" in outcome.verdict.reasons


def test_the_shipped_model_itself_is_promoted_as_ever(evaluate):
    outcome = evaluate(Bundle.load(PRETRAINED_FOLDER), budget=FEWER)
    assert outcome.verdict.promoted
    assert "the shipped model, is this very bundle" in outcome.verdict.reasons


@pytest.mark.slow
def test_a_better_one_takes_the_place_and_is_not_given_up_for_a_worse_within_the_old_margin(
    evaluate, tmp_path
):
    worse = copy_of_shipped(tmp_path / "worse", noise=0.1)
    little = copy_of_shipped(tmp_path / "little", noise=0.02)
    assert evaluate(worse, shipped=None).verdict.promoted
    better = evaluate(little, shipped=None)
    assert better.verdict.promoted
    assert better.verdict.bar.against == 1
    back = evaluate(worse, shipped=None)
    assert not back.verdict.promoted
    assert "precision 0.9" in words(back, "worse than version 2, the present champion beyond the interval: ")
