"""Calibrations of plans by reported outcomes: who counts how much, and what becomes of a version."""

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.errors import EvaluationError
from cspace.planning.cost import confidence_of_cost, fit_calibration
from services.evaluator.recalibrate import careful_fit, predicted_reports, recalibrate
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION
from services.outcomes import Spool, upload
from services.registry.entities import ModelReference
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry, FakeTracking

NAME = "cspace-sampler"
# Half of what the model is 97 % sure of collides there.
SHIFT = (2.0, 0.6)


def drawn(count, seed=0, shift=SHIFT):
    """Costs of plans that are stated with exp(-cost), and whether each was free."""
    rng = np.random.default_rng(seed)
    cost = np.exp(rng.normal(-3.0, 1.5, count))
    return cost, rng.random(count) < confidence_of_cost(cost, shift)


def rows_of(stated, free, clients=6, start=0, **more):
    return [
        {"kind": "plan", "model": f"{NAME}/1", "site": "lab", "client": f"c{number % clients}"}
        | {"request_id": f"r{number}", "problem": f"p{number}", "confidence": float(stated[number - start])}
        | {"collided": not free[number - start], "success": bool(free[number - start])}
        | more
        for number in range(start, start + len(stated))
    ]


class Platform:
    """Tracking and a registry with one version, and outcomes that were uploaded."""

    def __init__(self, folder):
        self.folder, self.tracking = folder, FakeTracking()
        self.registry = FakeRegistry(folder / "registry", self.tracking.runs)
        self.bundle = Bundle.load(write_tiny_bundle(folder / "bundle", validity=True))
        run = self.tracking.start("training", "run")
        tags = {"preset": "smoke"}
        self.registry.register(
            NAME, self.bundle.folder, run.run_id, self.bundle.digest, tags, alias=ALIAS_CHAMPION
        )

    def upload(self, rows):
        spool = Spool(self.folder / "outcomes", 2**28, lambda *_: None)
        for client in {row["client"] for row in rows}:
            assert spool.add([row for row in rows if row["client"] == client])
        list(upload(self.folder / "outcomes", self.tracking))

    def recalibrate(self, site=None, most=0.2):
        return recalibrate(ModelReference.parse(NAME), site, most, self.tracking, self.registry)


@pytest.fixture
def platform(tmp_path, verified_here):
    return Platform(tmp_path)


def honest(count, seed=0, **more):
    cost, free = drawn(count, seed)
    return rows_of(np.exp(-cost), free, **more)


def test_outcomes_make_the_challenger_with_another_calibration_once(platform):
    platform.upload(honest(200))
    found = platform.recalibrate()
    assert (str(found.version), found.version.aliases, found.plans) == (f"{NAME}/2", (ALIAS_CHALLENGER,), 200)
    assert found.version.tags["preset"] == "smoke"
    made = Bundle.load(platform.registry.download(found.version, platform.folder / "made"))
    [calibration] = made.spec.plan_calibration
    assert calibration == found.parameters
    # The networks are the same, and other plans of the place are predicted better.
    for name in ("encoder.onnx", "generator.onnx", "validity.onnx", "golden.npz"):
        assert (made.folder / name).read_bytes() == (platform.bundle.folder / name).read_bytes()
    cost, free = drawn(20_000, seed=9)
    assert (
        abs(confidence_of_cost(cost, calibration).mean() - free.mean())
        < 0.05
        < np.exp(-cost).mean() - free.mean()
    )
    assert platform.registry.by_alias(NAME, ALIAS_CHAMPION).number == 1
    assert platform.recalibrate().version == found.version
    # The gate counts the reports for this version alone.
    predicted = predicted_reports(made, platform.bundle, platform.tracking)
    assert predicted.loss < predicted.before
    assert predicted.gain.low > 0.0
    assert predicted_reports(platform.bundle, platform.bundle, platform.tracking) is None
    run = platform.tracking.runs[found.version.run_id]
    assert "figures/reliability.png" in run.artifacts
    assert [one["context"] for one in run.inputs] == ["calibration"]


def test_a_client_that_reports_without_end_does_not_outvote_the_others(platform):
    platform.upload(honest(60))
    stated = np.random.default_rng(1).choice([0.1, 0.3, 0.5], 900)
    platform.upload(rows_of(stated, np.ones(900, bool), start=1000, client="forger"))
    found = platform.recalibrate()
    assert found.plans == 75
    for confidence in (1e-6, 0.1, 0.3, 0.5, 0.9, 0.99):
        cost = np.array([-np.log(confidence)])
        assert confidence_of_cost(cost, found.parameters) < confidence + 0.05
    # What the others report still lowers it.
    assert confidence_of_cost(np.array([0.1]), found.parameters) < 0.7


REFUSED = {
    "one client": honest(200, clients=1),
    "two clients": honest(200, clients=2),
    "no problem is named": honest(200, problem=""),
    "near-copies of ten problems": [row | {"problem": row["problem"][-1]} for row in honest(200)],
    "no plan collides": [row | {"collided": False} for row in honest(200)],
    "four plans are free": [row | {"collided": number > 3} for number, row in enumerate(honest(200))],
    "another version's": honest(200, model=f"{NAME}/7"),
    "another place's": honest(200, site="elsewhere"),
    "nobody knows whether they collide": honest(200, collided=None),
}


@pytest.mark.parametrize("case", REFUSED)
def test_outcomes_that_prove_too_little_make_no_version(platform, case):
    platform.upload(REFUSED[case])
    with pytest.raises(EvaluationError, match="too few outcomes"):
        platform.recalibrate(site="lab")
    assert len(platform.registry.versions(NAME)) == 1


def test_a_single_client_counts_where_it_is_trusted_and_bad_rows_block_nothing(platform):
    rows = honest(60, clients=1)
    bad = [
        {"kind": "plan", "client": "c0", "request_id": 7},
        rows[0] | {"request_id": "x", "confidence": 7.0},
    ]
    platform.upload([*rows, *bad])
    assert platform.recalibrate(most=1.0).plans == 60


def test_outcomes_that_agree_with_what_is_stated_change_nothing(platform):
    cost, free = drawn(200, shift=(0.0, 1.0))
    platform.upload(rows_of(np.exp(-cost), free))
    with pytest.raises(EvaluationError, match="agree"):
        platform.recalibrate()


@pytest.mark.parametrize("shift", [(-1.5, 1.0), (0.0, 0.5), (1.5, 1.6), (-1.0, 0.4)])
def test_no_confidence_is_raised_beyond_the_careful_end(shift):
    rng = np.random.default_rng(4)
    cost, client = np.exp(rng.normal(-0.7, 1.2, 400)), rng.integers(8, size=400)
    free = rng.random(400) < confidence_of_cost(cost, shift)
    found = careful_fit(cost, free, client)
    assert found is not None
    every = np.exp(np.linspace(np.log(1e-6), np.log(30.0), 200))
    stated, now = np.exp(-every), confidence_of_cost(every, found)
    picks = rng.integers(400, size=(100, 400))
    again = [confidence_of_cost(every, fit_calibration(cost[one], free[one], 1.0)) for one in picks]
    raised = now > stated + 1e-6
    assert np.all(now[raised] <= np.quantile(again, 0.2, axis=0)[raised] + 1e-3)
