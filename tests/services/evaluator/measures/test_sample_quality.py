import numpy as np
import pytest

from cspace.errors import EvaluationError
from cspace.space import JointSpace, embed
from services.evaluator.measures.sample_quality import (
    SampleQuality,
    SceneQuality,
    energy_distance,
    sample_quality,
    summarise,
)

TORUS = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, True))


def quality(precision, energy=1.0, covered=0.9, knn=(0.95, 0.85)):
    return SampleQuality(precision, covered, energy, *knn)


def test_energy_distance_equals_its_definition_without_self_pairs(rng):
    first, second = TORUS.sample_uniform(rng, 7), TORUS.sample_uniform(rng, 5)
    x, y = embed(first), embed(second)
    cross = np.mean([[np.linalg.norm(a - b) for b in y] for a in x])
    within = [
        np.mean([np.linalg.norm(a - b) for i, a in enumerate(z) for j, b in enumerate(z) if i != j])
        for z in (x, y)
    ]
    assert energy_distance(first, second, TORUS) == pytest.approx(2 * cross - sum(within))


def test_the_two_ends_of_a_limited_joint_are_apart(rng):
    low, high = (rng.normal((first, 0.0), 0.01, (50, 2)) for first in (-3.05, 3.05))
    assert energy_distance(low, high, TORUS) < 0.4
    assert energy_distance(low, high, JointSpace((-3.1, -np.pi), (3.1, np.pi), (False, True))) > 10.0


def test_precision_is_the_free_share(rng):
    samples = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-1.0, 0.0]] * 2)
    measured = sample_quality(samples, TORUS.sample_uniform(rng, 10), TORUS, lambda q: q[:, 0] >= 0, 0.2)
    assert measured.precision == 0.75


def test_samples_have_the_share_of_each_other_s_manifold(rng):
    # Samples of one half of the torus: all look real, and half of the real ones are out of their reach.
    held_out, samples = TORUS.sample_uniform(rng, 1000), TORUS.sample_uniform(rng, 1000)
    samples[:, 0] = np.abs(samples[:, 0])
    measured = sample_quality(samples, held_out, TORUS, lambda q: q[:, 0] >= 0, 0.2)
    assert measured.knn_precision > 0.98
    assert measured.knn_recall == pytest.approx(0.55, abs=0.05)


@pytest.mark.parametrize("samples", [np.empty((0, 2)), np.zeros(3), np.array([[np.nan, 0.0], [0.0, 0.0]])])
def test_no_samples_and_samples_that_are_not_finite_are_errors(rng, samples):
    with pytest.raises(EvaluationError):
        sample_quality(samples, TORUS.sample_uniform(rng, 10), TORUS, lambda q: q[:, 0] >= 0, 0.2)


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


def test_the_manifolds_are_summarised_over_scenarios_for_every_kind_of_samples(rng):
    scenes = [
        SceneQuality(i, quality(0.9, knn=(i / 10, 0.2)), quality(0.6), quality(1.0, 0.0, knn=(1.0, 0.99)))
        for i in range(11)
    ]
    summary = summarise(scenes, rng)
    assert summary.sampler.knn_precision.estimate == pytest.approx(0.5)
    assert summary.sampler.knn_precision.low < 0.4
    assert summary.sampler.knn_precision.high > 0.6
    assert (summary.sampler.knn_recall.low, summary.sampler.knn_recall.high) == pytest.approx((0.2, 0.2))
    assert summary.uniform.knn_precision.estimate == pytest.approx(0.95)
    assert summary.real.knn_recall.estimate == pytest.approx(0.99)


def test_no_scenarios_are_an_error(rng):
    with pytest.raises(EvaluationError):
        summarise([], rng)
