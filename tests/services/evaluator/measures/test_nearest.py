"""Coverage and the k-NN manifolds on known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cspace.errors import EvaluationError
from cspace.space import JointSpace
from services.evaluator.measures.sample_quality import KnnQuality, coverage, covered, knn_precision_recall

TORUS = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, True))
MIXED = JointSpace((-np.pi, -3.0), (np.pi, 3.0), (True, False))
LINE = JointSpace((-6.0,), (6.0,), (False,))


def test_coverage_by_hand():
    held_out = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [-1.0, 0.0]])
    samples = np.array([[0.1, 0.1], [1.0, 1.19], [2.2, 2.2]])
    assert coverage(held_out, samples, TORUS, 0.2) == 0.5
    assert covered(held_out, samples, TORUS, 0.2).tolist() == [True, True, False, False]


def test_coverage_goes_round_circles_and_not_round_limits():
    held_out, samples = np.array([[3.1, 2.95]]), np.array([[-3.1, 2.95]])
    assert coverage(held_out, samples, MIXED, 0.2) == 1.0
    turned = JointSpace((-3.0, -np.pi), (3.0, np.pi), (False, True))
    assert coverage(held_out[:, ::-1], samples[:, ::-1], turned, 0.2) == 1.0
    assert coverage(np.array([[0.0, 2.95]]), np.array([[0.0, -2.95]]), MIXED, 0.2) == 0.0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_coverage_equals_the_distance_matrix(seed):
    rng = np.random.default_rng(seed)
    held_out, samples = TORUS.sample_uniform(rng, 60), TORUS.sample_uniform(rng, 80).astype(np.float32)
    matrix = TORUS.distance(held_out[:, None], samples[None].astype(np.float64))
    assert coverage(held_out, samples, TORUS, 0.2) == np.mean(matrix.min(axis=1) <= 0.2)


def column(*values):
    return np.array(values)[:, None]


def test_the_manifolds_by_hand():
    # Radii of the real ones: 1, 1, 2. Of the generated ones, in their order: 0.1, 3.4, 0.2, 0.2, 0.1.
    real, generated = column(0.0, 1.0, 3.0), column(1.9, -1.5, 4.9, 5.1, 2.0)
    found = knn_precision_recall(real, generated, LINE, k=1)
    assert found == KnnQuality(pytest.approx(3 / 5), pytest.approx(2 / 3))


def test_neighbours_are_found_round_a_circle_and_not_round_a_limit():
    # Ten points on either side of the seam, 0.01 rad apart.
    below = column(*(np.pi - 0.01 * np.arange(10) - 0.004))
    above = column(*(-np.pi + 0.01 * np.arange(10) + 0.004))
    circle, interval = JointSpace((-np.pi,), (np.pi,), (True,)), JointSpace((-np.pi,), (np.pi,), (False,))
    across = knn_precision_recall(below, above, circle, k=5)
    # The outermost ball reaches 0.05 rad, from 0.004 rad before the seam to 0.046 rad behind it.
    assert across == KnnQuality(0.5, 0.5)
    assert knn_precision_recall(below, above, interval, k=5) == KnnQuality(0.0, 0.0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.sampled_from([TORUS, MIXED]))
def test_the_manifolds_equal_those_of_the_distance_matrix(seed, k, space):
    rng = np.random.default_rng(seed)
    real, generated = space.sample_uniform(rng, 12), 0.6 * space.sample_uniform(rng, 20)

    def share(points, members):
        radii = np.sort(space.distance(members[:, None], members), axis=1)[:, k]
        return np.mean((space.distance(points[:, None], members) <= radii).any(axis=1))

    expected = KnnQuality(share(generated, real), share(real, generated))
    assert knn_precision_recall(real, generated, space, k) == expected


@pytest.mark.parametrize(("real", "generated", "k"), [(5, 9, 5), (9, 5, 5), (9, 9, 0), (0, 9, 1)])
def test_balls_without_a_neighbour_to_reach_are_errors(rng, real, generated, k):
    groups = TORUS.sample_uniform(rng, real), TORUS.sample_uniform(rng, generated)
    with pytest.raises(EvaluationError):
        knn_precision_recall(*groups, TORUS, k)
