from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import EvaluationError
from services.evaluator.topology import (
    geometry_score,
    living_times,
    mean_living_times,
    relative_living_times,
)

CASES = Path(__file__).parent / "data" / "living_times.npz"
CASE_NAMES = ("disk_0.007812", "ring7_0.000937", "ring_0.125000", "square_0.001250", "tworing_0.007812")


def circle(count, rng, centre=(0.0, 0.0), noise=0.02):
    angle = rng.uniform(-np.pi, np.pi, count)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1) + np.asarray(centre)
    return points + rng.normal(0.0, noise, points.shape)


def disk(count, rng):
    angle, radius = rng.uniform(-np.pi, np.pi, count), np.sqrt(rng.random(count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


@pytest.mark.parametrize("name", CASE_NAMES)
def test_living_times_equal_the_original_implementation_on_fixed_landmarks(name):
    with np.load(CASES) as cases:
        points, index, gamma, expected = (cases[f"{name}__{key}"] for key in ("X", "idx", "gamma", "rlt"))
    times = relative_living_times(points, index, float(gamma), i_max=100)
    np.testing.assert_allclose(times.values, expected, atol=1e-6)


@pytest.mark.parametrize("name", CASE_NAMES)
def test_values_and_remainder_sum_to_one_when_counts_exceed_i_max(name):
    with np.load(CASES) as cases:
        points, index, gamma = (cases[f"{name}__{key}"] for key in ("X", "idx", "gamma"))
    full = relative_living_times(points, index, float(gamma), i_max=100)
    short = relative_living_times(points, index, float(gamma), i_max=2)
    assert short.values.sum() + short.remainder == pytest.approx(1.0)
    assert short.remainder == pytest.approx(full.values[2:].sum() + full.remainder)


def test_living_times_of_hand_made_intervals():
    # One loop in [1, 4), two in [2, 3), none in [0, 1); the last lives to the end at 5.
    times = living_times(np.array([[1.0, 4.0], [2.0, 3.0], [4.0, np.inf]]), alpha_max=5.0, i_max=2)
    np.testing.assert_allclose(times.values, [0.2, 0.6])
    assert times.remainder == pytest.approx(0.2)


def test_no_interval_means_zero_loops_all_the_time():
    times = living_times(np.empty((0, 2)), alpha_max=1.0, i_max=4)
    np.testing.assert_array_equal(times.values, [1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("centres", "loops"), [(((0, 0),), 1), (((0, 0), (5, 0)), 2)])
def test_circles_have_as_many_loops_as_there_are_circles(rng, centres, loops):
    points = np.concatenate([circle(400, rng, centre) for centre in centres])
    times = mean_living_times(points, rng, draws=10, gamma=1 / 8)
    assert int(times.values.argmax()) == loops
    assert times.values[loops] > 0.6


def test_a_disk_has_no_loop_most_of_the_time(rng):
    times = mean_living_times(disk(800, rng), rng, draws=10, gamma=1 / 8)
    assert int(times.values.argmax()) == 0


def test_a_circle_is_nearer_to_another_circle_than_to_a_disk(rng):
    one, other, filled = (
        mean_living_times(cloud, rng, draws=10, gamma=1 / 8)
        for cloud in (circle(500, rng), circle(500, rng), disk(500, rng))
    )
    assert geometry_score(one, other) < 0.1 * geometry_score(one, filled)


def test_the_score_is_blind_to_position():
    times = [
        mean_living_times(
            circle(300, np.random.default_rng(3)) + shift, np.random.default_rng(4), draws=4, gamma=1 / 8
        )
        for shift in (0.0, 5.0)
    ]
    assert geometry_score(*times) == pytest.approx(0.0, abs=1e-6)


def test_draws_are_seeded_and_do_not_depend_on_the_mapper():
    cloud = circle(300, np.random.default_rng(5))
    serial = mean_living_times(cloud, np.random.default_rng(6), draws=4)
    with ThreadPoolExecutor(2) as pool:
        parallel = mean_living_times(cloud, np.random.default_rng(6), draws=4, mapper=pool.map)
    other = mean_living_times(cloud, np.random.default_rng(7), draws=4)
    np.testing.assert_array_equal(serial.values, parallel.values)
    assert not np.array_equal(serial.values, other.values)


def test_landmarks_are_drawn_without_replacement():
    seen = []

    def spy(work, picks):
        seen.extend(picks)
        return map(work, seen)

    mean_living_times(circle(70, np.random.default_rng(8)), np.random.default_rng(9), draws=5, mapper=spy)
    assert [len(set(pick.tolist())) for pick in seen] == [64] * 5


@pytest.mark.parametrize(("count", "draws"), [(63, 1), (100, 0)])
def test_too_few_points_or_draws_are_an_error(rng, count, draws):
    with pytest.raises(EvaluationError, match="expected 64 points"):
        mean_living_times(disk(count, rng), rng, draws=draws)


def test_an_impossible_complex_is_an_error(rng):
    with pytest.raises(EvaluationError, match="witness complex"):
        relative_living_times(np.empty((0, 2)), np.arange(3), 0.1)
