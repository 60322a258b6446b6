"""The client's joint space beside the project's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cspace import space
from cspace_client import answers
from cspace_client.answers import JointSpace

OURS = space.JointSpace((-np.pi, -4.0), (np.pi, 1.0), (True, False))
MIXED = JointSpace(OURS.lower, OURS.upper, OURS.periodic)


@given(arrays(np.float64, (4, 2), elements=st.floats(-20.0, 20.0)))
def test_the_clients_joint_space_is_the_projects(rows):
    np.testing.assert_array_equal(MIXED.wrap(rows), OURS.wrap(rows))
    # Three turns are less than 20 rad.
    near = np.abs(rows[:, 0]) <= answers.MAX_CIRCLE_RAD
    np.testing.assert_array_equal(MIXED.admits(rows), OURS.contains(rows) & near)
    drawn = [one.sample_uniform(np.random.default_rng(3), 5) for one in (MIXED, OURS)]
    np.testing.assert_array_equal(*drawn)


def test_the_client_rounds_to_limits_as_the_service_does():
    assert answers.LIMIT_TOLERANCE_RAD == space.LIMIT_TOLERANCE_RAD
    assert answers.MAX_CIRCLE_RAD == space.MAX_CIRCLE_RAD
    rows = [[0.0, 1.0 + 1e-10], [0.0, -4.00009], [7.0, 0.5], [0.0, 1.001]]
    clamped = MIXED.clamp(rows)
    np.testing.assert_array_equal(clamped, [[0.0, 1.0], [0.0, -4.0], [7.0, 0.5], [0.0, 1.001]])
    assert MIXED.admits(clamped).tolist() == [True, True, True, False]
    assert not MIXED.admits([90.0, 0.5])
