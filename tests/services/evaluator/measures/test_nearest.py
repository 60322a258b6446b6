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


def test_identical_groups_are_in_each_other_s_manifold(rng):
    group = TORUS.sample_uniform(rng, 200)
    assert knn_precision_recall(group, group.astype(np.float64), TORUS) == KnnQuality(1.0, 1.0)


def test_groups_apart_share_nothing(rng):
    real, generated = rng.uniform(-0.5, 0.5, (2, 100, 2))
    assert knn_precision_recall(real, generated + np.pi / 2, TORUS) == KnnQuality(0.0, 0.0)


def test_a_generator_that_repeats_one_real_configuration_is_precise_and_recalls_that_one_alone(rng):
    real = TORUS.sample_uniform(rng, 400)
    assert knn_precision_recall(real, np.tile(real[7], (400, 1)), TORUS) == KnnQuality(1.0, 1 / 400)


def test_a_generator_that_drops_a_mode_is_precise_and_recalls_the_other_half(rng):
    modes = np.array([[-1.5, 0.0], [1.5, 0.0]])
    real = np.concatenate([mode + rng.uniform(-0.5, 0.5, (400, 2)) for mode in modes])
    found = knn_precision_recall(real, modes[0] + rng.uniform(-0.5, 0.5, (800, 2)), TORUS)
    assert found.precision > 0.95
    assert 0.45 < found.recall <= 0.5


def test_samples_spread_too_wide_are_imprecise_and_recall_everything(rng):
    real = rng.uniform(-0.5, 0.5, (400, 2))
    found = knn_precision_recall(real, TORUS.sample_uniform(rng, 4000), TORUS)
    assert found.precision < 0.05
    assert found.recall > 0.99


def test_neighbours_are_found_round_a_circle_and_not_round_a_limit():
    # Ten points on either side of the seam, 0.01 rad apart.
    below = column(*(np.pi - 0.01 * np.arange(10) - 0.004))
    above = column(*(-np.pi + 0.01 * np.arange(10) + 0.004))
    circle, interval = JointSpace((-np.pi,), (np.pi,), (True,)), JointSpace((-np.pi,), (np.pi,), (False,))
    across = knn_precision_recall(below, above, circle, k=5)
    # The outermost ball reaches 0.05 rad, from 0.004 rad before the seam to 0.046 rad behind it.
    assert across == KnnQuality(0.5, 0.5)
    assert knn_precision_recall(below, above, interval, k=5) == KnnQuality(0.0, 0.0)


def test_precision_is_recall_with_the_groups_exchanged(rng):
    first, second = TORUS.sample_uniform(rng, 60), rng.uniform(-1.0, 1.0, (90, 2))
    there, back = knn_precision_recall(first, second, TORUS), knn_precision_recall(second, first, TORUS)
    assert (there.precision, there.recall) == (back.recall, back.precision)
    assert there.precision != there.recall


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
