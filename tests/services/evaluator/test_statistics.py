import numpy as np
import pytest
from scipy.stats import beta

from services.evaluator.statistics import (
    bootstrap_interval,
    censored_as_largest,
    clopper_pearson,
    difference_interval,
    mean_interval,
    ratio_of_medians_interval,
    ratio_of_sums_interval,
)


def test_the_mean_interval_is_near_the_normal_one_and_reproducible(rng):
    values = rng.normal(2.0, 1.0, 400)
    interval = mean_interval(values, np.random.default_rng(1))
    half = 1.96 * values.std() / np.sqrt(400)
    assert (interval.estimate, interval.count) == (pytest.approx(values.mean()), 400)
    # An interval of 90 % would be a sixth narrower.
    assert (interval.high - interval.low) / 2.0 == pytest.approx(half, rel=0.08)
    assert mean_interval(values, np.random.default_rng(1)) == interval
    assert f"{mean_interval([0.5, 0.5], rng):.2f}" == "0.50 [0.50, 0.50]"


def test_pairs_and_rows_are_resampled_together(rng):
    # Large differences between scenarios cancel in the pairs.
    base = rng.normal(0.0, 10.0, 50)
    interval = difference_interval(base + 1.0, base, rng)
    assert (interval.low, interval.high) == pytest.approx((1.0, 1.0))
    assert ratio_of_sums_interval([1.0, 1.0, 1.0], [1.0, 2.0, 0.001], rng).estimate == pytest.approx(
        3 / 3.001
    )
    assert ratio_of_medians_interval([2.0, 4.0, 9.0], [1.0, 2.0, 3.0], rng).estimate == pytest.approx(2.0)
    rows = bootstrap_interval([[1.0, 10.0], [3.0, 30.0]], lambda rows: rows.sum(axis=(-1, -2)), rng)
    assert rows.estimate == 44.0


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (7, 10), (30, 30)])
def test_clopper_pearson_equals_the_beta_quantiles(successes, trials):
    interval = clopper_pearson(successes, trials)
    low = 0.0 if successes == 0 else beta.ppf(0.025, successes, trials - successes + 1)
    high = 1.0 if successes == trials else beta.ppf(0.975, successes + 1, trials - successes)
    assert (interval.low, interval.high) == pytest.approx((low, high))


def test_a_censored_run_counts_as_the_largest_value_seen():
    np.testing.assert_array_equal(censored_as_largest([1.0, 9.0, 2.0], [False, False, True]), [1.0, 9.0, 9.0])
