"""Predictions of a challenger beside the champion's, weighed by what became of the plans."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle
from services.evaluator.evaluation import job
from services.evaluator.evaluation.gate import Bar, Verdict
from services.evaluator.evaluation.job import evaluate_version
from services.evaluator.evaluation.shadow import shadow_evidence, with_evidence
from services.names import MODEL_NAME, OUTCOMES_EXPERIMENT
from services.registry.ports import ModelVersion
from services.registry.promotion import decisions_of, promote
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeTracking
from tests.services.evaluator.evaluation.test_job import challenged, request

NAME, CHAMPION = "panda-sampler", 3
VERSION = ModelVersion(NAME, 4, "run", "", (), {}, 0)
PASSED = Verdict(promoted=True, reasons=("better in everything",), bar=Bar())


def row(number, stated, stated_beside, **more):
    base = {"kind": "shadow", "client": "c", "request_id": f"r{number}", "model": f"{NAME}/4"}
    return base | {"beside": f"{NAME}/3", "confidence": stated, "confidence_beside": stated_beside} | more


def outcome(number, collided):
    base = {"kind": "plan", "client": "c", "request_id": f"r{number}", "model": f"{NAME}/3"}
    return base | {"confidence": 0.9, "collided": collided, "success": not collided}


def tracked(folder, *batches, tracking=None):
    tracking = tracking or FakeTracking()
    for rows in batches:
        path = folder / "outcomes.jsonl"
        path.write_text("".join(json.dumps(one) + "\n" for one in rows))
        with tracking.start(OUTCOMES_EXPERIMENT, "outcomes") as run:
            run.artifact(path)
    return tracking


def evidence(folder, *batches, champion=CHAMPION):
    return shadow_evidence(VERSION, champion, tracked(folder, *batches), np.random.default_rng(0))


def plans(ours, theirs, collided, count=40):
    """Predictions for free plans and for those that collide, every fourth, and their outcomes."""
    hits = [number % 4 == 0 for number in range(count)]
    rows = [row(number, ours[hit], theirs[hit]) for number, hit in enumerate(hits)]
    return rows, [outcome(number, hit) for number, hit in enumerate(hits)][:collided]


def test_a_version_that_predicts_outcomes_worse_is_not_promoted(tmp_path):
    found = evidence(tmp_path, *plans(ours=(0.6, 0.9), theirs=(0.9, 0.4), collided=40))
    assert (found.plans, found.outcomes) == (40, 40)
    assert found.gain.high < 0.0
    verdict = with_evidence(PASSED, found)
    assert not verdict.promoted
    assert verdict.reasons[0] == "better in everything"
    assert "predicts 40 outcomes worse beyond the interval" in verdict.reasons[1]


def test_a_version_that_predicts_them_better_is_as_the_gate_says(tmp_path):
    found = evidence(tmp_path, *plans(ours=(0.9, 0.4), theirs=(0.6, 0.9), collided=40))
    # Of free plans -log 0.6 + log 0.9, of the quarter that collides -log 0.1 + log 0.6.
    gain = 0.75 * np.log(0.9 / 0.6) + 0.25 * np.log(0.6 / 0.1)
    assert found.gain.estimate == pytest.approx(gain)
    verdict = with_evidence(PASSED, found)
    assert verdict.promoted
    assert "outcomes better beyond the interval" in verdict.reasons[1]


def test_few_outcomes_are_told_and_decide_nothing(tmp_path):
    found = evidence(tmp_path, *plans(ours=(0.1, 0.1), theirs=(0.9, 0.4), collided=19))
    assert (found.outcomes, found.gain) == (19, None)
    # The version would release none, the champion all of them.
    assert found.agreement == 0.0
    assert with_evidence(PASSED, found).promoted
    assert "19 with an outcome; 20 would count" in with_evidence(PASSED, found).reasons[1]


def test_only_comparisons_with_the_present_champion_count_and_each_once(tmp_path):
    rows = [row(0, 0.9, 0.8), row(1, 0.9, 0.8, beside=f"{NAME}/2"), row(2, 0.9, 0.8, model=f"{NAME}/5")]
    found = evidence(tmp_path, rows, [row(0, 0.9, 0.8), row(3, 0.1, 0.8)])
    assert (found.plans, found.agreement) == (2, 0.5)
    assert evidence(tmp_path, rows, champion=9) is None
    assert evidence(tmp_path, rows, champion=None) is None
    assert with_evidence(PASSED, None) == PASSED


def test_an_evaluation_weighs_what_servers_found(tmp_path, verified_here, monkeypatch):
    # The gate passes: the tiny model is no better than uniform, and that is not the point here.
    monkeypatch.setattr(job, "decide", lambda evaluation, bar: replace(PASSED, bar=bar))
    tracking, registry = challenged(tmp_path, Bundle.load(write_tiny_bundle(tmp_path / "bundle")))
    promote(registry, registry.version(MODEL_NAME, 1), "the first")
    second = Bundle.load(write_tiny_bundle(tmp_path / "second", scale=0.5))
    registry.register(
        MODEL_NAME, second.folder, next(iter(tracking.runs)), second.digest, {}, alias="challenger"
    )
    names = {f"{NAME}/3": f"{MODEL_NAME}/1", f"{NAME}/4": f"{MODEL_NAME}/2"}
    worse = [
        [{key: names.get(value, value) for key, value in one.items()} for one in rows]
        for rows in plans(ours=(0.6, 0.9), theirs=(0.9, 0.4), collided=40)
    ]
    tracked(tmp_path, *worse, tracking=tracking)
    outcome = evaluate_version(request(), tracking, registry, progress=lambda line: None)
    assert not outcome.verdict.promoted
    assert "predicts 40 outcomes worse" in decisions_of(registry.version(MODEL_NAME, 2))[0].reasons[-1]
