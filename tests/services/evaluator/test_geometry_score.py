"""GS against the original implementation and known shapes, and GS-C with the complements of clouds."""

from pathlib import Path

import gudhi
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cspace.space import JointSpace
from services.evaluator.metrics.geometry_score import (
    complement_score,
    geometry_score,
    mean_living_times,
    relative_living_times,
    sample_complement,
    turned_living_times,
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


@pytest.mark.parametrize("name", CASE_NAMES)
def test_living_times_equal_the_original_implementation_on_fixed_landmarks(name):
    with np.load(CASES) as cases:
        points, index, gamma, expected = (cases[f"{name}__{key}"] for key in ("X", "idx", "gamma", "rlt"))
    times = relative_living_times(points, index, float(gamma), i_max=100)
    np.testing.assert_allclose(times, expected, atol=1e-6)


# First Betti numbers. The relaxation ends at an eighth of the diameter, below the radius of every hole.
SHAPES = [(circle, 1), (disk, 0), (two_circles, 2), (annulus, 1)]


@pytest.mark.parametrize(("shape", "loops"), SHAPES)
def test_a_shape_has_its_betti_number_of_loops_for_most_of_the_filtration(shape, loops, rng):
    times = mean_living_times(shape(1500, rng), rng, draws=10, gamma=1 / 8)
    assert times[loops] > 0.5


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


TORUS = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, True))
LIMITED = JointSpace((-1.0, -2.0), (1.0, 2.0), (False, False))


def square_with_hole(count, rng, half=1.0):
    points = TORUS.sample_uniform(rng, 4 * count)
    return points[np.abs(points).max(axis=1) > half][:count]


def test_the_complement_fills_the_hole_and_nothing_else(rng):
    complement = sample_complement(square_with_hole(2000, rng), TORUS, rng, 3000)
    assert complement.shape == (3000, 2)
    assert np.mean(np.abs(complement).max(axis=1) < 1.0) > 0.97
    # Evenly weighted by area: each quarter of the hole gets its share.
    assert np.mean(complement[:, 0] > 0) == pytest.approx(0.5, abs=0.05)


def turned(points, seed, space=TORUS):
    return turned_living_times(points, space, np.random.default_rng(seed), draws=12)


def scored(first, second, space, seed):
    """GS-C of two clouds with the complements from the points."""
    rng = np.random.default_rng(seed)
    complements = [turned(sample_complement(p, space, rng, 1000), seed + 1, space) for p in (first, second)]
    return complement_score(turned(first, seed + 2, space), turned(second, seed + 3, space), *complements)


def block(count, rng, centre, space, half=0.5):
    """Points in a square or cube."""
    return np.asarray(centre) + rng.uniform(-half, half, (count, space.dim))


def test_a_shifted_set_is_equal_to_gs_and_not_to_gsc_inside_the_joint_limits():
    # In the middle of the limits the complement goes round the block, in the corner it does not.
    rng = np.random.default_rng(7)
    middle = block(1000, rng, (0.0, 0.0), LIMITED)
    shifted = middle + np.array([0.5, 1.5])
    plain = [mean_living_times(p, np.random.default_rng(1), draws=5) for p in (middle, shifted)]
    assert geometry_score(*plain) == pytest.approx(0.0, abs=1e-6)
    away = [scored(middle, shifted, LIMITED, seed) for seed in range(3)]
    again = [scored(middle, block(1000, rng, (0.0, 0.0), LIMITED), LIMITED, seed) for seed in range(3)]
    assert min(away) > max(again)
