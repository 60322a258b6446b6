"""Joint spaces of circles and limited joints, at any turn and of any range."""

from math import pi

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cspace.errors import DatasetError
from cspace.space import JointSpace

MIXED = JointSpace((-pi, -1.0), (pi, 2.0), (True, False))
rows = arrays(np.float64, (5, 2), elements=st.floats(-1e3, 1e3))


@st.composite
def spaces(draw):
    ends, wraps = [], []
    for _ in range(2):
        wraps.append(draw(st.booleans()))
        low = draw(st.floats(-20.0, 20.0))
        ends.append((-pi, pi) if wraps[-1] else (low, low + draw(st.floats(1e-3, 20.0))))
    return JointSpace(tuple(low for low, _ in ends), tuple(high for _, high in ends), tuple(wraps))


def inside(space, configurations):
    """Within every joint's range as real numbers, circles without their upper end."""
    values = np.asarray(configurations, dtype=np.float64)
    upper = np.where(space.periodic, values < space.upper, values <= space.upper)
    return bool(np.all((values >= space.lower) & upper))


@given(spaces(), rows)
def test_what_is_bounded_lies_inside_and_stays_where_it_is_from_then_on(space, configurations):
    bounded = space.bound(configurations)
    assert inside(space, bounded)
    np.testing.assert_array_equal(space.bound(bounded), bounded)


@given(spaces(), rows)
@example(JointSpace((0.0, 5e-324), (1.0, 0.5), (False, False)), np.zeros((1, 2)))
def test_single_precision_lies_inside_as_real_numbers(space, configurations):
    cast = space.to_float32(configurations)
    assert cast.dtype == np.float32
    assert inside(space, cast)
    np.testing.assert_allclose(
        space.difference(cast, space.bound(configurations)),
        0.0,
        atol=2e-6 * (1.0 + max(map(abs, space.upper))),
    )


@given(spaces(), rows, rows)
def test_a_difference_leads_from_one_to_the_other_inside_the_limits(space, first, second):
    start, end = space.bound(first), space.bound(second)
    step = space.difference(start, end)
    np.testing.assert_allclose(space.difference(space.wrap(start + step), end), 0.0, atol=1e-9)
    assert np.all(np.abs(step) <= np.where(space.periodic, pi, np.subtract(space.upper, space.lower)) + 1e-9)
    limited = ~np.asarray(space.periodic)
    np.testing.assert_array_equal(step[:, limited], (end - start)[:, limited])
    np.testing.assert_allclose(space.distance(start, end), space.distance(end, start), atol=1e-9)


def test_what_is_outside_comes_in_by_whole_turns_or_to_the_nearer_limit():
    assert MIXED.bound([4.0, 2.0 * pi + 1.5]) == pytest.approx([4.0 - 2.0 * pi, 1.5])
    assert MIXED.bound([0.0, 2.5])[1] == 2.0
    # Round the circle 5.0 is -1.28: the lower limit is nearer.
    assert MIXED.bound([0.0, 5.0])[1] == -1.0
    wide = JointSpace((-2.9,), (4.0,), (False,))
    assert wide.bound([4.5]) == pytest.approx([4.5 - 2.0 * pi])
    assert wide.bound([3.9])[0] == 3.9


def test_the_embedding_keeps_limited_joints_in_rad_behind_the_circles():
    np.testing.assert_allclose(MIXED.embed([pi / 2.0, 1.5]), [0.0, 1.0, 1.5], atol=1e-15)
    assert MIXED.volume == pytest.approx(6.0 * pi)


LIMITED = JointSpace((-2.9671, -pi), (2.8973, pi), (False, True), ("shoulder", "wrist"))


@pytest.mark.parametrize(
    "rows", [np.float32([[2.8973, 0.0]]), [[2.8973 + 1e-10, 0.0]], [[2.8973 + 9e-5, 0.0]]]
)
def test_what_rounding_moved_beyond_a_limit_is_taken_as_the_limit(rows):
    np.testing.assert_array_equal(LIMITED.admitted(rows, "rows lie outside"), [[2.8973, 0.0]])


@pytest.mark.parametrize(
    ("row", "joint"), [([2.8975, 0.0], "shoulder"), ([0.0, 90.0], "wrist"), ([np.nan, 0.0], "shoulder")]
)
def test_what_lies_outside_is_refused_by_its_joints_name(row, joint):
    with pytest.raises(DatasetError, match=f"row 1: {joint}"):
        LIMITED.admitted([[0.0, 0.0], row], "rows lie outside", DatasetError)
