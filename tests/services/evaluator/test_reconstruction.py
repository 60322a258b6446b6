import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cspace.errors import EvaluationError
from cspace.space import JointSpace, embed
from services.evaluator.reconstruction import (
    SampleQuality,
    SceneQuality,
    coverage,
    energy_distance,
    sample_quality,
    summarise,
)

TORUS = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, True))
MIXED = JointSpace((-np.pi, -3.0), (np.pi, 3.0), (True, False))


def quality(precision, energy=1.0, covered=0.9):
    return SampleQuality(precision, covered, energy)


def test_coverage_by_hand():
    held_out = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [-1.0, 0.0]])
    samples = np.array([[0.1, 0.1], [1.0, 1.19], [2.2, 2.2]])
    assert coverage(held_out, samples, TORUS) == 0.5


def test_coverage_goes_round_circles_and_not_round_limits():
    held_out, samples = np.array([[3.1, 2.95]]), np.array([[-3.1, 2.95]])
    assert coverage(held_out, samples, MIXED) == 1.0
    assert (
        coverage(held_out[:, ::-1], samples[:, ::-1], JointSpace((-3.0, -np.pi), (3.0, np.pi), (False, True)))
        == 1.0
    )
    assert coverage(np.array([[0.0, 2.95]]), np.array([[0.0, -2.95]]), MIXED) == 0.0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_coverage_equals_the_distance_matrix(seed):
    rng = np.random.default_rng(seed)
    held_out, samples = TORUS.sample_uniform(rng, 60), TORUS.sample_uniform(rng, 80).astype(np.float32)
    matrix = TORUS.distance(held_out[:, None], samples[None].astype(np.float64))
    assert coverage(held_out, samples, TORUS) == np.mean(matrix.min(axis=1) <= 0.2)


def test_energy_distance_equals_its_definition_without_self_pairs(rng):
    first, second = TORUS.sample_uniform(rng, 7), TORUS.sample_uniform(rng, 5)
    x, y = embed(first), embed(second)
    cross = np.mean([[np.linalg.norm(a - b) for b in y] for a in x])
    within = [
        np.mean([np.linalg.norm(a - b) for i, a in enumerate(z) for j, b in enumerate(z) if i != j])
        for z in (x, y)
    ]
    assert energy_distance(first, second) == pytest.approx(2 * cross - sum(within))


def test_energy_distance_of_equal_distributions_averages_zero():
    rng = np.random.default_rng(2)
    values = [
        energy_distance(TORUS.sample_uniform(rng, 40), TORUS.sample_uniform(rng, 40)) for _ in range(200)
    ]
    assert abs(np.mean(values)) < 3 * np.std(values) / np.sqrt(200)
    assert min(values) < 0 < max(values)


def test_two_points_on_opposite_sides_of_a_circle():
    first, second = np.zeros((2, 1)), np.full((2, 1), np.pi)
    assert energy_distance(first, second) == pytest.approx(4.0)


def test_precision_is_the_free_share(rng):
    samples = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-1.0, 0.0]])
    measured = sample_quality(samples, TORUS.sample_uniform(rng, 10), TORUS, lambda q: q[:, 0] >= 0)
    assert measured.precision == 0.75


@pytest.mark.parametrize("samples", [np.empty((0, 2)), np.zeros(3), np.array([[np.nan, 0.0], [0.0, 0.0]])])
def test_no_samples_and_samples_that_are_not_finite_are_errors(rng, samples):
    with pytest.raises(EvaluationError):
        sample_quality(samples, TORUS.sample_uniform(rng, 10), TORUS, lambda q: q[:, 0] >= 0)


def test_edr_sums_over_scenarios_before_it_divides(rng):
    # An open scenario, where uniform's distance is almost zero, would blow up a mean of ratios.
    scenes = [
        SceneQuality(0, quality(0.9, 0.1), quality(0.6, 1.0), quality(1.0, 0.0)),
        SceneQuality(1, quality(0.9, 0.1), quality(0.99, 1e-6), quality(1.0, 0.0)),
    ]
    summary = summarise(scenes, rng)
    assert summary.sampler.edr.estimate == pytest.approx(0.2, rel=1e-4)
    assert summary.uniform.edr.estimate == 1.0
    assert summary.real.edr.estimate == 0.0


def test_the_summary_names_gain_low_quantile_and_minimum(rng):
    scenes = [
        SceneQuality(i, quality(0.5 + i / 20), quality(0.4 + i / 20), quality(1.0, 0.0)) for i in range(11)
    ]
    summary = summarise(scenes, rng)
    assert summary.precision_gain.low == pytest.approx(0.1)
    assert summary.sampler.precision_p10.estimate == pytest.approx(0.55)
    assert summary.sampler.precision_minimum == 0.5


def test_no_scenarios_are_an_error(rng):
    with pytest.raises(EvaluationError):
        summarise([], rng)
