from pathlib import Path

import gudhi
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cspace.errors import EvaluationError
from services.evaluator.measures.topology import (
    geometry_score,
    living_times,
    mean_living_times,
    relative_living_times,
    witness_complex,
)

CASES = Path(__file__).with_name("living_times.npz")
CASE_NAMES = ("disk_0.007812", "ring7_0.000937", "ring_0.125000", "square_0.001250", "tworing_0.007812")


def circle(count, rng, centre=(0.0, 0.0), noise=0.02):
    angle = rng.uniform(-np.pi, np.pi, count)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1) + np.asarray(centre)
    return points + rng.normal(0.0, noise, points.shape)


def disk(count, rng, inner=0.0):
    angle, radius = rng.uniform(-np.pi, np.pi, count), np.sqrt(rng.uniform(inner**2, 1.0, count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def two_circles(count, rng):
    return np.concatenate([circle(count // 2, rng), circle(count // 2, rng, (5.0, 0.0))])


def annulus(count, rng):
    return disk(count, rng, inner=0.5)


def sphere(count, rng):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def flat_torus(count, rng):
    """The product of two unit circles in four dimensions."""
    return np.concatenate([circle(count, rng), circle(count, rng)], axis=1)


def ring_torus(count, rng, radius=2.0, tube=1.0):
    """A torus of revolution in three dimensions, even by area."""
    around, along, keep = rng.uniform(-np.pi, np.pi, (3, 4 * count))
    outward = radius + tube * np.cos(along)
    even = (keep + np.pi) / (2.0 * np.pi) < outward / (radius + tube)
    points = np.stack([outward * np.cos(around), outward * np.sin(around), tube * np.sin(along)], axis=1)
    return points[even][:count]


@pytest.mark.parametrize("name", CASE_NAMES)
def test_living_times_equal_the_original_implementation_on_fixed_landmarks(name):
    with np.load(CASES) as cases:
        points, index, gamma, expected = (cases[f"{name}__{key}"] for key in ("X", "idx", "gamma", "rlt"))
    times = relative_living_times(points, index, float(gamma), i_max=100)
    np.testing.assert_allclose(times.values, expected, atol=1e-6)


def test_values_and_remainder_sum_to_one_when_counts_exceed_i_max():
    with np.load(CASES) as cases:
        points, index, gamma = (cases[f"tworing_0.007812__{key}"] for key in ("X", "idx", "gamma"))
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


# First Betti numbers. The relaxation ends at an eighth of the diameter, below the radius of every hole.
SHAPES = [(circle, 1), (disk, 0), (two_circles, 2), (annulus, 1), (sphere, 0), (flat_torus, 2)]


@pytest.mark.parametrize(("shape", "loops"), SHAPES)
def test_a_shape_has_its_betti_number_of_loops_for_most_of_the_filtration(shape, loops, rng):
    times = mean_living_times(shape(1500, rng), rng, draws=10, gamma=1 / 8)
    assert times.values[loops] > 0.5


def test_a_torus_in_three_dimensions_has_two_loops(rng):
    # A sixteenth of the diameter of 6 is below half the tube's radius; 64 landmarks are too few round it.
    times = mean_living_times(ring_torus(3000, rng), rng, draws=10, gamma=1 / 16, landmarks=128)
    assert times.values[2] > 0.5


def test_a_circle_is_nearer_to_another_circle_than_to_a_disk(rng):
    one, other, filled = (
        mean_living_times(cloud, rng, draws=10, gamma=1 / 8)
        for cloud in (circle(500, rng), circle(500, rng), disk(500, rng))
    )
    assert geometry_score(one, other) < 0.1 * geometry_score(one, filled)


def test_draws_are_seeded():
    cloud = circle(300, np.random.default_rng(5))
    first, again, other = (
        mean_living_times(cloud, np.random.default_rng(seed), draws=4) for seed in (6, 6, 7)
    )
    np.testing.assert_array_equal(first.values, again.values)
    assert not np.array_equal(first.values, other.values)


def gudhi_simplices(distances, alpha_max):
    table = [sorted(enumerate(row), key=lambda entry: entry[1]) for row in distances.tolist()]
    tree = gudhi.WitnessComplex(table).create_simplex_tree(max_alpha_square=alpha_max, limit_dimension=2)
    return {tuple(vertices): value for vertices, value in tree.get_filtration()}


def our_simplices(distances, alpha_max):
    built = witness_complex(distances, alpha_max)
    vertices = {(vertex,): 0.0 for vertex in range(built.landmarks)}
    edges = zip(map(tuple, built.edges.T.tolist()), built.edge_values.tolist(), strict=True)
    triangles = zip(map(tuple, built.triangles.T.tolist()), built.triangle_values.tolist(), strict=True)
    return vertices | dict(edges) | dict(triangles)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("ties", [False, True])
def test_the_complex_is_gudhis_to_the_last_bit(seed, ties):
    rng = np.random.default_rng(seed)
    count, dimension = int(rng.integers(3, 200)), int(rng.integers(1, 5))
    points = (
        rng.integers(0, 5, (count, dimension)).astype(float) if ties else rng.normal(size=(count, dimension))
    )
    landmarks = rng.choice(count, min(count, int(rng.integers(3, 40))), replace=False)
    distances = cdist(points, points[landmarks])
    for share in (0.001, 0.03, 0.3):
        alpha_max = float(distances.max()) * share
        assert our_simplices(distances, alpha_max) == gudhi_simplices(distances, alpha_max)


@pytest.mark.parametrize(("count", "draws"), [(63, 1), (100, 0)])
def test_too_few_points_or_draws_are_an_error(rng, count, draws):
    with pytest.raises(EvaluationError, match="expected 64 points"):
        mean_living_times(disk(count, rng), rng, draws=draws)


def test_an_impossible_complex_is_an_error(rng):
    with pytest.raises(EvaluationError, match="witness complex"):
        relative_living_times(np.empty((0, 2)), np.arange(3), 0.1)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_points_that_are_not_finite_are_an_error(rng, wrong):
    points = disk(100, rng)
    points[7, 0] = wrong
    with pytest.raises(EvaluationError, match="finite"):
        relative_living_times(points, np.arange(10), 0.1)
