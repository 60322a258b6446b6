import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from services.planner.plotting import wrapped_segments

ANGLE = st.floats(-np.pi, 3.14159)
PAIR = st.tuples(ANGLE, ANGLE)
LIMITED = PlanarArm(joint_limits_rad=((-3.0, 3.0), None)).space


def test_a_segment_over_a_seam_is_drawn_at_both_sides():
    lines = wrapped_segments(TWO_LINK.space, np.array([[3.0, 0.0]]), np.array([[-3.0, 0.0]]), (0, 1))
    ends = sorted(tuple(line[:, 0]) for line in lines)
    assert np.allclose(ends, [[3.0 - 2 * np.pi, -3.0], [3.0, 2 * np.pi - 3.0]])


def test_a_limited_joint_has_no_seam():
    lines = wrapped_segments(LIMITED, np.array([[2.9, 0.0]]), np.array([[-2.9, 0.0]]), (0, 1))
    assert np.allclose(lines, [[[2.9, 0.0], [-2.9, 0.0]]])


@given(start=PAIR, end=PAIR)
@example(start=(1.0 / 3.0, 0.0), end=(-np.pi, 0.0))
def test_no_line_is_longer_than_its_segment_and_both_ends_are_shown(start, end):
    space = TWO_LINK.space
    lines = wrapped_segments(space, np.array([start]), np.array([end]), (0, 1))
    lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1)
    assert np.allclose(lengths, space.distance(start, end))
    assert np.min(np.linalg.norm(lines[:, 0] - start, axis=-1)) < 1e-9
    assert np.min(np.linalg.norm(lines[:, 1] - end, axis=-1)) < 1e-9
