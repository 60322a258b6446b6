"""What bundles promise of configurations that pass, against scenes whose truth is drawn here."""

import numpy as np
import pytest

from training.clusters.calibration import FINE, Scored, choose_bounded, collision_bound


def drawn(rng: np.random.Generator, size: int = 400) -> Scored:
    """A head that is right more often the surer it is, in a scene that is harder or easier than others."""
    confidence = rng.uniform(0.0, 1.0, size)
    hard = rng.uniform(0.05, 0.3)
    return Scored(confidence, rng.uniform(0.0, 1.0, size) > hard * (1.0 - confidence))


def scenes(seed: int, count: int) -> list[Scored]:
    rng = np.random.default_rng(seed)
    return [drawn(rng) for _ in range(count)]


def test_the_lowest_threshold_that_would_promise_enough_is_chosen_by_its_third_alone() -> None:
    given = scenes(0, 300)
    found = choose_bounded(given, 0.04)
    assert FINE[0] < found < FINE[-1]
    as_made = [given[index - index % 3] for index in range(300)]
    lower = FINE[FINE.index(found) - 1]
    assert collision_bound(as_made, found)["at_most"] <= 0.04 < collision_bound(as_made, lower)["at_most"]
    others = [one if index % 3 == 0 else drawn(np.random.default_rng(1)) for index, one in enumerate(given)]
    assert choose_bounded(others, 0.04) == found


def test_promises_are_kept_on_average_over_draws_of_scenes() -> None:
    found = [collision_bound(scenes(seed, 60), 0.8) for seed in range(40)]
    assert np.mean([one["measured"] for one in found]) <= np.mean([one["at_most"] for one in found])
    # The nineteenth of twenty: at most two scenes of twenty-one, and the error of 800 of them.
    assert np.mean([one["measured_violations"] for one in found]) <= 2.0 / 21.0 + 0.03
    assert np.mean([one["measured_violations"] for one in found]) > 0.0


def test_what_lets_nothing_pass_risks_nothing() -> None:
    bad = Scored(np.array([0.9, 0.9, 0.1]), np.array([True, False, False]))
    none = Scored(np.array([0.1]), np.array([False]))
    found = collision_bound([none, bad, bad] * 2, 0.8)
    assert (found["at_most"], found["measured"]) == (pytest.approx((0.5 * 2 + 1.0) / 3.0), pytest.approx(0.5))
    assert collision_bound([bad, none, none], 0.8)["measured"] == 0.0
