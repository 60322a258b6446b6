"""Confidence that is fitted to what became of plans."""

import json
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import EvaluationError, InputError, RegistryError
from cspace.planning.cost import calibration_error, confidence_of_cost
from services.evaluator.recalibrate import Fit, fitted, recalibrate
from services.names import ALIAS_CHAMPION, CALIBRATIONS_EXPERIMENT, OUTCOMES_EXPERIMENT
from services.registry.calibration import SiteCalibration
from tests.fakes.registry import FakeRegistry, FakeTracking

MODEL, SITE = "panda-sampler/3", "lab-3"
# Half of what the model is 97 % sure of collides there.
SHIFT = (2.0, 0.6)
IN_USE = f"calibration-{SITE}/1"


def drawn(count, seed=0, shift=SHIFT):
    rng = np.random.default_rng(seed)
    cost = np.exp(rng.normal(-3.0, 1.5, count))
    return cost, rng.random(count) < confidence_of_cost(cost, shift)


def rows_of(cost, free, start=0, **more):
    stated = confidence_of_cost(cost, more.pop("stated_by", (0.0, 1.0)))
    return [
        {"kind": "plan", "model": MODEL, "site": SITE, "client": "c", "request_id": f"r{start + at}"}
        | {"confidence": float(stated[at]), "collided": not bool(free[at]), "success": bool(free[at])}
        | more
        for at in range(len(cost))
    ]


class Platform:
    """Tracking and registry, and outcomes that were uploaded to them."""

    def __init__(self, folder: Path) -> None:
        self.tracking, self.folder = FakeTracking(), folder
        self.registry = FakeRegistry(folder / "registry", self.tracking.runs)

    def upload(self, rows) -> None:
        path = self.folder / "outcomes.jsonl"
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
        with self.tracking.start(OUTCOMES_EXPERIMENT, "outcomes") as run:
            run.artifact(path)

    def recalibrate(self, model=None):
        return recalibrate(SITE, model, self.tracking, self.registry)


@pytest.fixture
def platform(tmp_path: Path) -> Platform:
    return Platform(tmp_path)


def test_two_hundred_outcomes_bring_the_calibration_error_of_other_plans_down(platform: Platform) -> None:
    platform.upload(rows_of(*drawn(200)))
    found = platform.recalibrate()
    assert (found.plans, str(found.version), found.version.aliases) == (200, IN_USE, (ALIAS_CHAMPION,))
    calibration = SiteCalibration.of(found.version)
    assert calibration.model == MODEL
    others, free = drawn(20_000, seed=9)
    before = calibration_error(confidence_of_cost(others, (0.0, 1.0)), free)
    after = calibration_error(confidence_of_cost(others, calibration.after((0.0, 1.0))), free)
    assert before > 0.2
    errors = [
        calibration_error(confidence_of_cost(others, fitted(*drawn(200, seed)).parameters), free)
        for seed in range(9)
    ]
    assert np.median(errors) < 0.05
    assert max(after, *errors) < 0.1
    # What it says of itself is about that.
    assert found.fit.error_before == pytest.approx(before, abs=0.08)
    assert found.fit.error == pytest.approx(after, abs=0.08)
    run = platform.tracking.runs[found.version.run_id]
    assert run.experiment == CALIBRATIONS_EXPERIMENT
    assert "figures/reliability.png" in run.artifacts
    assert [one["context"] for one in run.inputs] == ["calibration"]


def test_the_same_outcomes_make_the_same_version_and_more_make_the_next(platform: Platform) -> None:
    platform.upload(rows_of(*drawn(100)))
    first = platform.recalibrate()
    # The batch once more, as after an interruption, and a sender's repetition.
    platform.upload(rows_of(*drawn(100)))
    assert platform.recalibrate().version.number == first.version.number == 1
    platform.upload(rows_of(*drawn(100, seed=2), start=100))
    assert platform.recalibrate().version.number == 2
    assert platform.registry.by_alias(f"calibration-{SITE}", ALIAS_CHAMPION).number == 2


def test_confidence_that_a_calibration_has_changed_already_is_changed_back_first(platform: Platform) -> None:
    platform.upload(rows_of(*drawn(300)))
    first = platform.recalibrate()
    by = SiteCalibration.of(first.version).after((0.0, 1.0))
    cost, free = drawn(300, seed=3)
    platform.upload(rows_of(cost, free, start=300, stated_by=by, calibration=IN_USE))
    second = platform.recalibrate()
    own = Platform(platform.folder / "own")
    own.folder.mkdir()
    own.upload(rows_of(*drawn(300)) + rows_of(cost, free, start=300))
    expected = own.recalibrate()
    assert second.fit.parameters == pytest.approx(expected.fit.parameters, abs=1e-4)


def test_other_sites_models_and_plans_that_nobody_checked_do_not_count(platform: Platform) -> None:
    rows = rows_of(*drawn(60))
    for row in rows[:30]:
        row["model"] = "panda-sampler/2"
    unknown = rows_of(*drawn(40), start=100, collided=None) + rows_of(*drawn(40), start=200, site="lab-4")
    samples = [{"kind": "samples", "model": MODEL, "site": SITE, "request_id": "s", "checked": 9, "free": 9}]
    platform.upload(rows[:31] + unknown + samples)
    assert SiteCalibration.of(platform.recalibrate().version).model == "panda-sampler/2"
    with pytest.raises(InputError, match="the site is no name"):
        recalibrate("lab 3'", None, platform.tracking, platform.registry)
    with pytest.raises(EvaluationError, match=r"at least 20 of panda-sampler/3.*got 1; the site has 30 of"):
        platform.recalibrate(MODEL)


def test_a_model_that_is_right_is_left_as_it_is(platform: Platform) -> None:
    fit = fitted(*drawn(40, shift=(0.0, 1.0)))
    assert fit.parameters == pytest.approx((0.0, 1.0), abs=0.4)
    worse = [seed for seed in range(20) if not fitted(*drawn(40, seed, shift=(0.0, 1.0))).better]
    assert len(worse) >= 8
    platform.upload(rows_of(*drawn(40, worse[0], shift=(0.0, 1.0))))
    found = platform.recalibrate()
    assert isinstance(found.fit, Fit)
    assert found.version.aliases == ()


@pytest.mark.parametrize("tags", [{}, {"model": MODEL, "offset": "nan", "slope": "1"}, {"slope": "0.0"}])
def test_tags_that_are_no_calibration_are_refused(platform: Platform, tags: dict[str, str]) -> None:
    with platform.tracking.start(CALIBRATIONS_EXPERIMENT, "by hand") as run:
        version = platform.registry.record("calibration-x", run.run_id, tags)
    with pytest.raises(RegistryError):
        SiteCalibration.of(version)
