import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cspace.planning.paths import spread_points
from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import RESOLUTION_RAD, Family, PathFinder, draw_problem

SPACE = TWO_LINK.space


@pytest.mark.parametrize(("family", "seed", "index"), [(Family.UNIFORM, 11, 0), (Family.NARROW, 32, 0)])
def test_a_path_is_free_and_joins_its_ends(family, seed, index):
    problem = draw_problem(family, Split.DEMO, seed, index)
    path = PathFinder(problem.scenario).path(problem.start, problem.goal)
    np.testing.assert_allclose(path[[0, -1]], SPACE.wrap([problem.start, problem.goal]))
    checker = CollisionChecker(problem.scenario)
    assert checker.edge_batch(path[:-1], path[1:], RESOLUTION_RAD).all()


def test_between_two_parts_of_the_free_space_there_is_no_path():
    problem = draw_problem(Family.DISCONNECTED, Split.DEMO, 11, 0)
    assert PathFinder(problem.scenario).path(problem.start, problem.goal) is None


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=2, max_size=6, unique=True))
@settings(deadline=None)
def test_points_are_spread_evenly_over_the_length(corners):
    path = np.array(corners)
    points = spread_points(path, 401, SPACE)
    np.testing.assert_allclose(points[[0, -1]], SPACE.wrap(path[[0, -1]]), atol=1e-9)
    length = SPACE.distance(path[:-1], path[1:]).sum()
    gaps = SPACE.distance(points[:-1], points[1:])
    # A corner cuts the straight distance of its neighbours short, and nothing else does.
    assert np.all(gaps <= length / 400 * (1.0 + 1e-6) + 1e-9)
    assert np.sum(gaps < length / 400 * 0.999 - 1e-9) <= len(path)


def test_the_seam_is_crossed_the_short_way():
    points = spread_points(np.array([[3.0, 0.0], [-3.0, 0.0]]), 3, SPACE)
    np.testing.assert_allclose(points[:, 0], [3.0, -np.pi, -3.0])
