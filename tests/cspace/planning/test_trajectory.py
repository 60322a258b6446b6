"""Trajectories: times along a path within limits, by finite differences of a dense evaluation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from cspace.planning.paths import spaced
from cspace.planning.trajectory import TOLERANCE_RAD, timed
from cspace.space import JointSpace

SPACE = JointSpace((-3.0, -np.pi, -3.0), (3.0, np.pi, 3.0), (False, True, False))
VELOCITY, ACCELERATION = (2.0, 1.0, 3.0), (10.0, 4.0, 2.0)
DENSE_S = 2e-3


def free(rows):
    return np.ones(len(rows), dtype=bool)


def blocked(rows):
    return np.zeros(len(rows), dtype=bool)


def outside_ball(centre, radius_rad):
    return lambda rows: SPACE.distance(centre, rows) > radius_rad


def outside_quadrant(away_rad):
    return lambda rows: (rows[:, 0] > -away_rad) | (rows[:, 1] < away_rad)


def dense(trajectory):
    """(n, d) rad every so many ms, as a robot's controller interpolates positions and velocities."""
    spline = CubicHermiteSpline(trajectory.times_s, trajectory.positions, trajectory.velocities)
    return spline(np.arange(0.0, trajectory.times_s[-1], DENSE_S))


paths = st.lists(
    st.tuples(*[st.floats(-2.9, 2.9).map(lambda one: round(one, 3))] * 3), min_size=2, max_size=8, unique=True
).map(np.array)


@settings(max_examples=50, deadline=None)
@given(paths, st.sampled_from([free, blocked, outside_ball(np.zeros(3), 1.0)]))
def test_a_trajectory_keeps_the_limits_the_ends_and_near_the_path(path, are_free):
    found = timed(path, SPACE, VELOCITY, ACCELERATION, are_free)
    assert (found.times_s[0], found.positions.shape) == (0.0, (len(found.times_s), 3))
    assert (np.diff(found.times_s) > 0.0).all()
    assert not found.velocities[[0, -1]].any()
    assert np.allclose(found.positions[0], path[0])
    assert SPACE.distance(found.positions[-1], path[-1]) < 1e-9
    states = dense(found)
    speeds = np.diff(states, axis=0) / DENSE_S
    assert (np.abs(speeds) <= np.multiply(VELOCITY, 1.0 + 1e-6)).all()
    assert (np.abs(np.diff(speeds, axis=0)) / DENSE_S <= np.multiply(ACCELERATION, 1.0 + 1e-3) + 1e-3).all()
    line = spaced(path, SPACE, 0.02)
    few = states[:: len(states) // 100 + 1]
    assert SPACE.distance(few[:, None], line[None]).min(axis=1).max() <= TOLERANCE_RAD + 0.01


def test_a_corner_is_cut_only_where_that_is_free():
    path = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for away_rad, stops in ((0.02, False), (0.001, True)):
        are_free = outside_quadrant(away_rad)
        assert are_free(spaced(path, SPACE, 0.001)).all()
        found = timed(path, SPACE, (1.0,) * 3, (4.0,) * 3, are_free)
        assert are_free(dense(found)).all()
        assert np.any(~found.velocities[1:-1].any(axis=1)) == stops
    wide = timed(path, SPACE, (1.0,) * 3, (4.0,) * 3, free)
    assert wide.times_s[-1] < timed(path, SPACE, (1.0,) * 3, (4.0,) * 3, blocked).times_s[-1]


def test_a_straight_edge_takes_the_least_time():
    found = timed([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]], SPACE, (1.0,) * 3, (2.0,) * 3, blocked)
    assert found.times_s == pytest.approx([0.0, 0.5, 2.0, 2.5])
    assert found.velocities[:, 0] == pytest.approx([0.0, 1.0, 1.0, 0.0])


def test_a_circle_goes_on_and_a_path_of_one_point_stands_still():
    found = timed([[0.0, 3.0, 0.0], [0.0, -3.0, 0.0]], SPACE, VELOCITY, ACCELERATION, free)
    assert found.positions[-1, 1] == pytest.approx(2.0 * np.pi - 3.0)
    still = timed([[0.0, 1.0, 0.0]], SPACE, VELOCITY, ACCELERATION, free)
    assert (still.times_s.tolist(), still.positions.tolist()) == ([0.0], [[0.0, 1.0, 0.0]])
