"""Whether plans collide more often than stated: by outcomes, with few false alarms."""

import math
from pathlib import Path

import numpy as np
import pytest

from inference_api.drift import ALARM, CollisionDrift, e_value
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import api_over

SITE = "cell-4"


def outcomes(rng, count, times=1.0):
    """Plans whose odds of a collision are so many times the stated ones."""
    confidence = rng.beta(4.0, 1.2, count)
    odds = times * (1.0 - confidence) / confidence
    return list(zip(confidence.tolist(), (rng.random(count) < odds / (1.0 + odds)).tolist(), strict=True))


@pytest.mark.parametrize("confidence", [0.0, 0.05, 0.5, 0.9, 0.995, 1.0])
def test_the_evidence_of_a_plan_is_1_on_average_where_it_is_as_stated_and_less_where_it_is_surer(confidence):
    risk = 1.0 - confidence
    collided, free = (e_value(confidence, one) for one in (True, False))
    assert collided > 1.0 > free > 0.0
    assert risk * collided + (1.0 - risk) * free <= 1.0 + 1e-3
    if 0.01 < risk < 0.99:
        assert risk * collided + (1.0 - risk) * free == pytest.approx(1.0)
    for less in (0.0, 0.5 * risk):
        assert less * collided + (1.0 - less) * free <= 1.0


def test_a_year_of_plans_as_stated_raises_no_alarm():
    drift = CollisionDrift()
    rng = np.random.default_rng(0)
    # 500 plans a day.
    assert max(drift.add(SITE, outcomes(rng, 500)) for _ in range(365)) < ALARM


def test_plans_that_collide_more_often_are_told_within_some_hundred_outcomes(caplog):
    rng, needed = np.random.default_rng(1), []
    for _ in range(20):
        drift = CollisionDrift()
        # After a month without a fault.
        for _ in range(30):
            drift.add(SITE, outcomes(rng, 100))
        count = 0
        while drift.add(SITE, outcomes(rng, 1, times=4.0)) < ALARM:
            count += 1
        needed.append(count)
    assert np.median(needed) < 200
    assert max(needed) < 500
    assert caplog.text.count("the site 'cell-4' collide more often") == 20


def test_sites_are_apart_and_the_clearest_is_told():
    drift = CollisionDrift()
    before = drift.add("bad", [(0.9, True)] * 20)
    assert drift.add("good", [(0.9, False)] * 20) == before > ALARM
    assert CollisionDrift().add("none", []) == 0.0


def test_reported_plans_are_weighed_in_the_metrics(tmp_path: Path, bundles: dict[str, Path]) -> None:
    with api_over(tmp_path, bundles, None, outcomes_folder=tmp_path / "outcomes") as api:
        weigh(api)


def weigh(api: ApiClient) -> None:
    def evidence() -> float:
        lines = api.get("/metrics").text.splitlines()
        return float(next(one.split()[-1] for one in lines if one.startswith("cspace_collision_evidence ")))

    assert evidence() == 0.0
    plan = {"kind": "plan", "model": "m/1", "site": SITE, "success": False, "confidence": 0.95}
    plans = [plan | {"request_id": f"r{number}", "collided": number != 0} for number in range(8)]
    unknown = [plan | {"request_id": "u"}, plan | {"request_id": "v", "confidence": None, "collided": True}]
    samples = {"kind": "samples", "request_id": "s", "model": "m/1", "checked": 9, "free": 0}
    answer = api.post("/outcomes", json={"outcomes": [*plans, *unknown, samples]})
    assert answer.status_code == 202, answer.text
    expected = 0.0
    for number in range(8):
        expected = (expected + 1.0) * e_value(0.95, number != 0)
    assert evidence() == pytest.approx(math.log10(expected))
