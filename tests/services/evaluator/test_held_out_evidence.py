"""Held-out plans as evidence: which model says better what became of them."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.png import encode_png
from services.evaluator.evaluation import job
from services.evaluator.evaluation.gate import Bar, Comparison, verdict_of
from services.evaluator.evaluation.held_out import outcome_evidence
from services.evaluator.evaluation.job import evaluate_version
from services.evaluator.evaluation.rivals import Rival
from services.evaluator.measures.scenes import PackedBundle
from services.names import MODEL_NAME
from services.outcomes import KnownPlan, view_row
from services.registry.promotion import promote
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.registry import FakeTracking
from tests.services.evaluator.evaluation.test_gate import PLANAR, candidate
from tests.services.evaluator.evaluation.test_job import challenged, request
from tests.services.evaluator.test_shadow_evidence import PASSED
from tests.services.test_known_plans import uploaded

NOTHING = Comparison("version 3", ())
# The head of tiny bundles finds joints near 0 rad free, and others less so the farther away.
NEAR, FAR = (np.array([[at, at], [at + 0.5, at + 0.5]]) for at in (0.0, 2.5))


@pytest.fixture
def bundle(tmp_path):
    return Bundle.load(write_tiny_bundle(tmp_path / "tiny", validity=True))


@pytest.fixture
def rival(bundle, monkeypatch):
    """The present champion, which says 0.5 of everything."""
    other = Bundle.load(bundle.folder)
    monkeypatch.setattr(other, "score", lambda _, rows: np.full(len(rows), 0.5, dtype=np.float32))
    monkeypatch.setattr(PackedBundle, "load", lambda _: other)
    return Rival("version 3", other.spec.world, PackedBundle.pack(bundle), 3)


def images(count, *, held_out=True):
    """So many pictures that are held out, or are not."""
    found = (encode_png(picture(seed)) for seed in range(1000))
    chosen = (one for one in found if KnownPlan(one, NEAR, None, "").held_out == held_out)
    return [next(chosen) for _ in range(count)]


def tracked(folder, bundle, path, pictures, **end):
    """What a tracking server holds when plans through these pictures have ended so."""
    rows = []
    for number, image in enumerate(pictures):
        asked = {"request_id": f"r{number}", "client": None}
        rows.append(asked | view_row("m/3", bundle.robot, image, path, 1e6))
        rows.append(asked | {"kind": "plan", "model": "m/3", "success": False} | end)
    return uploaded(folder, rows)


def evidence(bundle, rival, tracking):
    return outcome_evidence(bundle, rival, tracking, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("path", "end", "better"),
    [(NEAR, {"collided": False}, True), (FAR, {"collided": True, "collided_at": 0.9}, False)],
)
def test_losses_are_of_what_was_free_and_of_where_it_collided(tmp_path, bundle, rival, path, end, better):
    pictures = [*images(20), *images(5, held_out=False)]
    found = evidence(bundle, rival, tracked(tmp_path, bundle, path, pictures, **end))
    assert (found.champion, found.plans) == (3, 20)
    gains = []
    for image in pictures[:20]:
        free, hit = KnownPlan(image, path, end.get("collided_at"), "").labelled(bundle.spec.world.space)
        shown = bundle.spec.world.read_picture(image)
        right = [
            *bundle.score(shown, free),
            *(1.0 - bundle.score(shown, rows) for rows in [hit] if len(rows)),
        ]
        gains.append(np.log(np.hstack(right)).mean() - np.log(0.5))
    assert found.gain.estimate == pytest.approx(np.mean(gains), abs=1e-6)
    assert better == bool(found.gain.low > 0.0)
    assert verdict_of(candidate(), Bar((found.beside(NOTHING),), against=3), PLANAR).promoted == better
    (measure,) = found.beside(NOTHING).gains
    assert (measure.better, measure.worse) == (better, not better)
    assert measure.theirs - measure.ours == pytest.approx(measure.gain.estimate)
    assert measure.theirs == pytest.approx(np.log(2.0))


def test_few_plans_are_told_and_decide_nothing_and_none_or_no_head_are_no_evidence(tmp_path, bundle, rival):
    few = tracked(tmp_path, bundle, FAR, images(19), collided=False)
    found = evidence(bundle, rival, few)
    assert (found.gain, str(found)) == (None, "19 held-out plans with an outcome; 20 would count")
    assert found.beside(NOTHING) is NOTHING
    assert evidence(bundle, rival, FakeTracking()) is None
    assert evidence(Bundle.load(write_tiny_bundle(tmp_path / "headless")), rival, few) is None


def test_an_evaluation_weighs_held_out_plans(tmp_path, bundle, verified_here, monkeypatch):
    decided = []
    monkeypatch.setattr(
        job, "decide", lambda evaluation, bar: decided.append(bar) or replace(PASSED, bar=bar)
    )
    tracking, registry = challenged(tmp_path, bundle)
    promote(registry, registry.version(MODEL_NAME, 1), "the first")
    second = Bundle.load(write_tiny_bundle(tmp_path / "second", validity=True, scale=0.5))
    registry.register(
        MODEL_NAME, second.folder, next(iter(tracking.runs)), second.digest, {}, alias="challenger"
    )
    seen = tracked(tmp_path / "spool", bundle, NEAR, images(20), collided=False)
    tracking.runs |= {f"outcomes-{number}": run for number, run in enumerate(seen.runs.values())}
    for run_id, run in tracking.runs.items():
        run.run_id = run_id
    evaluate_version(request(), tracking, registry, progress=lambda line: None)
    # Both have the same head.
    assert "beside version 1, predicts 20 held-out plans no different" in decided[0].notes[-1]
    (champions, *others) = decided[0].comparisons
    measure = champions.gains[-1]
    assert (measure.name, measure.gain.estimate) == ("log loss of held-out plans", 0.0)
    assert all("held-out" not in gain.name for one in others for gain in one.gains)
