from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cspace.errors import ScenarioError
from cspace.space import (
    JointSpace,
    Standardisation,
    circles,
    difference,
    embed,
    to_float32,
    unembed,
    wrap,
)

any_angle = st.floats(-1e4, 1e4)
pairs = arrays(np.float64, (4, 2), elements=any_angle)
MIXED = JointSpace((-pi, -1.0), (pi, 2.0), (True, False))


@given(arrays(np.float64, 6, elements=any_angle))
def test_wrapping_stays_in_the_interval_and_keeps_the_direction(angles):
    wrapped = wrap(angles)
    assert ((wrapped >= -pi) & (wrapped < pi)).all()
    np.testing.assert_allclose(np.cos(wrapped), np.cos(angles), atol=1e-9)
    np.testing.assert_allclose(np.sin(wrapped), np.sin(angles), atol=1e-9)


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(pi, -pi), (-pi, -pi), (3 * pi, -pi), (0.5, 0.5), (-pi - 1e-17, -pi)]
)
def test_the_seam_belongs_to_the_lower_end(angle, wrapped):
    assert wrap(angle) == pytest.approx(wrapped, abs=1e-15)
    assert wrap(angle) < pi


def test_a_tiny_negative_remainder_does_not_reach_the_upper_end():
    assert wrap(np.nextafter(-pi, -10.0)) < pi


def test_distance_goes_the_shorter_way_round():
    assert circles(2).distance([3.0, 0.0], [-3.0, 0.0]) == pytest.approx(2 * pi - 6.0)
    assert circles(2).distance([0.0, 0.0], [3.0, 4.0]) == pytest.approx(sqrt(9.0 + (2 * pi - 4.0) ** 2))
    assert difference(3.0, -3.0) == pytest.approx(2 * pi - 6.0)
    assert difference(-3.0, 3.0) == pytest.approx(6.0 - 2 * pi)


@given(pairs)
def test_embedding_and_back_is_wrapping(angles):
    np.testing.assert_allclose(circles(2).distance(unembed(embed(angles)), angles), 0.0, atol=1e-8)


def test_the_embedding_holds_all_cosines_before_the_sines():
    np.testing.assert_allclose(embed([0.0, pi / 2, pi]), [1, 0, -1, 0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(unembed([0.0, 5.0, 3.0, 0.0]), [pi / 2, 0.0])


def test_the_largest_angle_survives_the_cast():
    cast = to_float32([np.nextafter(pi, 0.0), -pi]).astype(np.float64)
    assert cast[0] < pi
    assert cast[1] >= -pi
    np.testing.assert_allclose(np.abs(cast), pi, atol=1e-6)


def test_limited_joints_neither_wrap_nor_go_round():
    np.testing.assert_allclose(MIXED.wrap([4.0, 1.5]), [4.0 - 2 * pi, 1.5])
    np.testing.assert_allclose(MIXED.difference([3.0, -1.0], [-3.0, 2.0]), [2 * pi - 6.0, 3.0])
    assert MIXED.distance([0.0, -1.0], [0.0, 2.0]) == pytest.approx(3.0)


def test_only_limited_joints_can_be_outside():
    inside = MIXED.contains([[100.0, 0.0], [0.0, 2.0], [0.0, 2.1], [0.0, -1.1]])
    assert inside.tolist() == [True, True, False, False]


def test_uniform_samples_fill_the_joint_space():
    samples = MIXED.sample_uniform(np.random.default_rng(0), 20_000)
    assert MIXED.contains(samples).all()
    np.testing.assert_allclose(samples.mean(axis=0), [0.0, 0.5], atol=0.05)
    np.testing.assert_allclose(samples.std(axis=0), [2 * pi / sqrt(12), 3 / sqrt(12)], atol=0.03)


def test_standardising_gives_zero_mean_and_unit_variance_and_goes_back():
    data = np.random.default_rng(1).normal([1.0, -2.0], [0.5, 3.0], (500, 2))
    scale = Standardisation.fit(data)
    standard = scale.standardise(data)
    np.testing.assert_allclose(standard.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(standard.std(axis=0), 1.0)
    np.testing.assert_allclose(scale.restore(standard), data)


@pytest.mark.parametrize(("mean", "std"), [((0.0,), (0.0,)), ((0.0,), (float("nan"),)), ((0.0, 0.0), (1.0,))])
def test_a_standardisation_that_cannot_be_undone_is_an_error(mean, std):
    with pytest.raises(ScenarioError, match="positive deviation"):
        Standardisation(mean, std)
