import numpy as np
import pytest
from scipy.stats import beta

from cspace.errors import EvaluationError
from services.evaluator.statistics import (
    bootstrap_interval,
    censored_as_largest,
    clopper_pearson,
    difference_interval,
    mean_interval,
    ratio_of_medians_interval,
    ratio_of_sums_interval,
    summarise_censored,
)


def test_the_mean_interval_is_near_the_normal_one(rng):
    values = rng.normal(2.0, 1.0, 400)
    interval = mean_interval(values, rng)
    half = 1.96 * values.std() / np.sqrt(400)
    assert interval.estimate == pytest.approx(values.mean())
    assert interval.low == pytest.approx(values.mean() - half, abs=0.02)
    assert interval.high == pytest.approx(values.mean() + half, abs=0.02)
    # An interval of 90 % would be a sixth narrower.
    assert (interval.high - interval.low) / 2.0 == pytest.approx(half, rel=0.08)
    assert interval.count == 400


def test_about_95_of_100_intervals_hold_the_true_mean():
    rng = np.random.default_rng(0)
    intervals = [mean_interval(rng.exponential(1.0, 60), rng) for _ in range(200)]
    held = np.mean([i.low <= 1.0 <= i.high for i in intervals])
    assert 0.88 <= held <= 0.98


def test_the_same_generator_gives_the_same_interval():
    values = np.arange(20.0)
    first, second = (mean_interval(values, np.random.default_rng(1)) for _ in range(2))
    assert first == second


def test_pairs_are_resampled_together(rng):
    # Large differences between scenarios cancel in the pairs.
    base = rng.normal(0.0, 10.0, 50)
    interval = difference_interval(base + 1.0, base, rng)
    assert interval.low == pytest.approx(1.0)
    assert interval.high == pytest.approx(1.0)


def test_a_ratio_of_sums_is_not_a_mean_of_ratios(rng):
    interval = ratio_of_sums_interval([1.0, 1.0, 1.0], [1.0, 2.0, 0.001], rng)
    assert interval.estimate == pytest.approx(3.0 / 3.001)


def test_a_ratio_of_medians_by_hand(rng):
    interval = ratio_of_medians_interval([2.0, 4.0, 9.0], [1.0, 2.0, 3.0], rng)
    assert interval.estimate == pytest.approx(2.0)
    assert interval.low <= 2.0 <= interval.high


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (7, 10), (10, 10), (30, 30)])
def test_clopper_pearson_equals_the_beta_quantiles(successes, trials):
    interval = clopper_pearson(successes, trials)
    low = 0.0 if successes == 0 else beta.ppf(0.025, successes, trials - successes + 1)
    high = 1.0 if successes == trials else beta.ppf(0.975, successes + 1, trials - successes)
    assert (interval.low, interval.high) == pytest.approx((low, high))
    assert interval.estimate == successes / trials


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda rng: mean_interval([], rng), "empty"),
        (lambda rng: clopper_pearson(0, 0), "0 of 0"),
        (lambda rng: clopper_pearson(3, 2), "3 of 2"),
        (lambda rng: mean_interval([1.0, np.nan], rng), "not finite"),
        (lambda rng: difference_interval([1.0, 2.0], [1.0], rng), "pair"),
    ],
)
def test_what_is_no_group_is_an_error(rng, call, words):
    with pytest.raises(EvaluationError, match=words):
        call(rng)


def test_censored_runs_rank_last_and_are_counted():
    summary = summarise_censored([1.0, 2.0, 3.0, 0.5], [False, False, False, True])
    assert summary.median == 3.0
    assert summary.p90_is_bound
    assert not summary.median_is_bound
    assert (summary.censored, summary.count) == (1, 4)


def test_a_median_among_censored_runs_is_a_bound():
    summary = summarise_censored([1.0, 5.0, 5.0], [False, True, True])
    assert summary.median == 5.0
    assert summary.median_is_bound


def test_a_censored_run_counts_as_the_largest_value_seen():
    np.testing.assert_array_equal(censored_as_largest([1.0, 9.0, 2.0], [False, False, True]), [1.0, 9.0, 9.0])


def test_an_interval_reads_with_its_limits(rng):
    assert f"{mean_interval([0.5, 0.5], rng):.2f}" == "0.50 [0.50, 0.50]"


def test_the_statistic_sees_whole_rows(rng):
    interval = bootstrap_interval([[1.0, 10.0], [3.0, 30.0]], lambda rows: rows.sum(axis=(-1, -2)), rng)
    assert interval.estimate == 44.0
