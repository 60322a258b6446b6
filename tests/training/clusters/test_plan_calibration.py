"""The calibration of plans: from cost to confidence."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.planning.cost import confidence_of_cost
from cspace.worlds import examples
from tests.bundles import write_tiny_bundle
from training.clusters.calibration import Planned, fit_plan_calibration, planned


def drawn(*parameters, count, seed=0):
    """So many plans for each number of pictures in turn."""
    rng = np.random.default_rng(seed)
    cost = np.exp(rng.normal(-1.0, 1.5, count))
    pictures = rng.integers(1, len(parameters) + 1, count)
    confidence = np.choose(pictures - 1, [confidence_of_cost(cost, one) for one in parameters])
    return Planned(cost, rng.random(count) < confidence, pictures)


@pytest.mark.parametrize("parameters", [(0.0, 1.0), (0.8, 0.5), (-1.0, 1.3)])
def test_the_fit_finds_what_the_plans_were_drawn_by(parameters):
    found = fit_plan_calibration(drawn(parameters, count=9000))
    assert found.parameters == (pytest.approx(parameters, abs=0.12),)
    assert found.metrics["plans/fitted"] == 9000
    assert found.metrics["plans/calibration_error"] < 0.04


def test_each_number_of_pictures_has_its_own_and_those_with_few_plans_lean_on_all():
    parameters = (0.8, 0.5), (0.0, 0.7), (-1.0, 0.9)
    plans = drawn(*parameters, count=9000)
    found = fit_plan_calibration(plans)
    for own, true in zip(found.parameters, parameters, strict=True):
        assert own == pytest.approx(true, abs=0.15)
    assert found.metrics["plans/calibration_error"] < 0.05
    some = plans.among((plans.pictures < 3) | (np.arange(9000) < 60))
    few = fit_plan_calibration(some)
    (all_alike,) = fit_plan_calibration(replace(some, pictures=np.ones_like(some.pictures))).parameters
    of_few, of_all = (
        np.linalg.norm(np.subtract(one, found.parameters[2])) for one in (few.parameters[2], all_alike)
    )
    assert 0.1 < of_few < 0.8 * of_all


def test_few_plans_change_little_and_none_nothing():
    few = fit_plan_calibration(drawn((3.0, 0.3), count=6))
    many = fit_plan_calibration(drawn((3.0, 0.3), count=6000))
    assert np.abs(np.subtract(few.parameters, (0.0, 1.0))).max() < 1.0
    assert many.parameters[0][0] > few.parameters[0][0]
    none = np.empty(0)
    assert fit_plan_calibration(Planned(none, none.astype(bool), none.astype(int))) is None
    assert fit_plan_calibration(drawn((3.0, 0.3), count=2)) is None


def test_a_path_without_cost_is_certain_and_a_higher_cost_never_is_more_confident():
    costs = np.array([0.0, 1e-3, 0.1, 1.0, 10.0, 1e9])
    for parameters in ((0.0, 1.0), (0.8, 0.5), (-5.0, 5.0)):
        sure = confidence_of_cost(costs, parameters)
        assert sure[0] == 1.0
        assert (np.diff(sure) <= 0.0).all()
        assert sure[-1] < 1e-6
    np.testing.assert_allclose(confidence_of_cost(costs, (0.0, 1.0)), np.exp(-costs), atol=1e-12)


@pytest.mark.slow
def test_plans_of_validation_problems_are_checked_against_the_ground_truth(tmp_path):
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", validity=True))
    world = examples()["two-link"]
    first = planned(bundle, world, 4)
    assert 1 <= len(first.cost) <= 4
    assert (first.cost > 0.0).all()
    again = planned(bundle, world, 4)
    np.testing.assert_array_equal(first.cost, again.cost)
    np.testing.assert_array_equal(first.free, again.free)
