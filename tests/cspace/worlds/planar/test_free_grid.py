import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import FreeGrid, distance_to_false
from cspace.worlds.planar.world import Disc, Scenario

ONE_LINK = PlanarArm(link_lengths_m=(2.0,))
# One disc above the base: the link collides while sin(angle) > (2^2 + 3^2 - 1.1^2) / (2 * 2 * 3).
ABOVE = Scenario(ONE_LINK, (Disc(0.0, 3.0),))
CONTACT_RAD = float(np.arcsin(11.79 / 12.0))


def by_hand(inside, spacing, wraps):
    """Every cell against every False cell, both ways round."""
    centres = np.argwhere(inside | True).astype(float)
    blocked = np.argwhere(~inside).astype(float)
    if not len(blocked):
        return np.full(inside.shape, np.inf)
    gaps = np.abs(centres[:, None] - blocked[None])
    sizes = np.array(inside.shape, dtype=float)
    gaps = np.where(wraps, np.minimum(gaps, sizes - gaps), gaps) * spacing
    return np.sqrt((gaps**2).sum(axis=-1)).min(axis=1).reshape(inside.shape)


@given(
    arrays(np.bool_, array_shapes(min_dims=1, max_dims=3, min_side=1, max_side=7)),
    st.lists(st.floats(0.1, 3.0), min_size=3, max_size=3),
    st.lists(st.booleans(), min_size=3, max_size=3),
)
@settings(deadline=None, max_examples=80)
def test_distances_are_those_of_an_exhaustive_search(inside, spacing, wraps):
    spacing, wraps = spacing[: inside.ndim], wraps[: inside.ndim]
    found = distance_to_false(inside, spacing, wraps)
    np.testing.assert_allclose(found, by_hand(inside, spacing, wraps), rtol=1e-9)


@pytest.mark.parametrize("robot", [TWO_LINK, THREE_LINK, PlanarArm(joint_limits_rad=((-1.0, 2.0), None))])
def test_a_cell_is_free_when_its_centre_is(robot):
    scenario = Scenario(robot, (Disc(2.5, 1.0), Disc(-1.5, -2.0)))
    grid = FreeGrid(scenario, 12)
    checker = CollisionChecker(scenario)
    for index in itertools.product(range(12), repeat=robot.dim):
        centre = np.array(robot.space.lower) + (np.array(index) + 0.5) * grid.spacing_rad
        assert grid.free[index] == checker.valid(centre)
        assert grid.cells_of(centre) == index


def test_the_clearance_of_one_link_is_the_angle_to_contact():
    grid = FreeGrid(ABOVE, 3600)
    for angle, distance in [
        (CONTACT_RAD - 0.3, 0.3),
        (-0.7, CONTACT_RAD + 0.7),
        # Round the back, across the seam.
        (-np.pi + 0.1, CONTACT_RAD + 0.1),
        (-np.pi / 2, CONTACT_RAD + np.pi / 2),
    ]:
        assert grid.clearance_rad[grid.cells_of([angle])] == pytest.approx(distance, abs=0.004)


def test_components_close_over_the_seams():
    class Drawn(FreeGrid):
        free = np.array(
            [
                [1, 0, 0, 1, 0],
                [0, 0, 0, 1, 0],
                [0, 1, 0, 0, 0],
                [0, 0, 0, 0, 0],
                [1, 0, 0, 0, 1],
            ],
            dtype=bool,
        )

    grid = Drawn(Scenario(TWO_LINK, ()), 5)
    labels = grid.components()
    assert (labels > 0).tolist() == grid.free.tolist()
    # (4, 0) meets (4, 4) over one seam and (0, 0) over the other; (0, 3) only touches (4, 4) in a corner.
    assert labels[4, 0] == labels[4, 4] == labels[0, 0]
    assert len({labels[0, 0], labels[0, 3], labels[2, 1]}) == 3
    corners = grid.components(diagonal=True)
    assert corners[0, 3] == corners[4, 4] == corners[0, 0]
    assert corners[2, 1] not in (0, corners[0, 0])
