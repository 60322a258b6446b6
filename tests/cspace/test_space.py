from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cspace.space import (
    JointSpace,
    circles,
    difference,
    wrap,
)

any_angle = st.floats(-1e4, 1e4)
MIXED = JointSpace((-pi, -1.0), (pi, 2.0), (True, False))


@given(arrays(np.float64, 6, elements=any_angle))
def test_wrapping_stays_in_the_interval_and_keeps_the_direction(angles):
    wrapped = wrap(angles)
    assert ((wrapped >= -pi) & (wrapped < pi)).all()
    np.testing.assert_allclose(np.cos(wrapped), np.cos(angles), atol=1e-9)
    np.testing.assert_allclose(np.sin(wrapped), np.sin(angles), atol=1e-9)


def test_distance_goes_the_shorter_way_round():
    assert circles(2).distance([3.0, 0.0], [-3.0, 0.0]) == pytest.approx(2 * pi - 6.0)
    assert circles(2).distance([0.0, 0.0], [3.0, 4.0]) == pytest.approx(sqrt(9.0 + (2 * pi - 4.0) ** 2))
    assert difference(3.0, -3.0) == pytest.approx(2 * pi - 6.0)
    assert difference(-3.0, 3.0) == pytest.approx(6.0 - 2 * pi)


def test_limited_joints_neither_wrap_nor_go_round():
    np.testing.assert_allclose(MIXED.wrap([4.0, 1.5]), [4.0 - 2 * pi, 1.5])
    np.testing.assert_allclose(MIXED.difference([3.0, -1.0], [-3.0, 2.0]), [2 * pi - 6.0, 3.0])
    assert MIXED.distance([0.0, -1.0], [0.0, 2.0]) == pytest.approx(3.0)


def test_uniform_samples_fill_the_joint_space():
    samples = MIXED.sample_uniform(np.random.default_rng(0), 20_000)
    assert MIXED.contains(samples).all()
    np.testing.assert_allclose(samples.mean(axis=0), [0.0, 0.5], atol=0.05)
    np.testing.assert_allclose(samples.std(axis=0), [2 * pi / sqrt(12), 3 / sqrt(12)], atol=0.03)
