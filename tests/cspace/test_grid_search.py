import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from cspace.space import JointSpace
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.free_grid import cell_of, centres, paths_to, spacing

SPACE = TWO_LINK.space
LIMITED = JointSpace((-1.0, -np.pi), (2.0, np.pi), (False, True))


def by_scipy(space, weights, goal):
    """Costs of the ways to the goal's cell, over a graph that is written out edge by edge."""
    shape, size = weights.shape, spacing(space, weights.shape)
    rows, columns, costs = [], [], []
    for cell in itertools.product(*map(range, shape)):
        for step in itertools.product((-1, 0, 1), repeat=len(shape)):
            there = np.add(cell, step)
            outside = (there < 0) | (there >= shape)
            if not any(step) or np.any(outside & ~np.array(space.periodic)):
                continue
            there = tuple(there % shape)
            if np.isfinite(weights[cell]) and np.isfinite(weights[there]) and cell != there:
                rows.append(np.ravel_multi_index(cell, shape))
                columns.append(np.ravel_multi_index(there, shape))
                costs.append(np.linalg.norm(step * size) * (weights[cell] + weights[there]) / 2.0)
    graph = {}
    # Of two ways between the same cells, round either side of a small circle, the cheaper one.
    for row, column, cost in zip(rows, columns, costs, strict=True):
        graph[row, column] = min(cost, graph.get((row, column), np.inf))
    keys = np.array(list(graph), dtype=int).reshape(-1, 2)
    matrix = coo_array((list(graph.values()), keys.T), shape=(weights.size, weights.size))
    source = int(np.ravel_multi_index(cell_of(space, shape, goal), shape))
    return dijkstra(matrix.tocsr(), indices=source).reshape(shape)


@given(
    arrays(np.float64, (5, 7), elements=st.sampled_from([1.0, 1.5, 2.0, 4.0, np.inf])),
    st.sampled_from([SPACE, LIMITED]),
)
@settings(deadline=None, max_examples=40)
def test_costs_are_those_of_another_program(weights, space):
    goal = centres(space, weights.shape)[17]
    weights[cell_of(space, weights.shape, goal)] = 1.0
    found = paths_to(space, weights, goal).costs
    np.testing.assert_allclose(found, by_scipy(space, weights, goal), rtol=1e-12)


@pytest.mark.parametrize("space", [SPACE, LIMITED])
def test_a_way_leads_from_cell_to_neighbouring_cell_and_costs_what_the_tree_says(space):
    rng = np.random.default_rng(3)
    weights = 1.0 + rng.random((20, 30)) * 5.0
    start, goal = centres(space, weights.shape)[[45, 555]]
    tree = paths_to(space, weights, goal)
    path = tree.path(start)
    np.testing.assert_allclose(path[[0, -1]], [start, goal])
    steps = np.abs(space.difference(path[:-1], path[1:]))
    assert np.all(steps <= spacing(space, weights.shape) * 1.0001)
    weight = np.array([weights[cell_of(space, weights.shape, point)] for point in path])
    cost = np.sum(np.linalg.norm(steps, axis=1) * (weight[:-1] + weight[1:]) / 2.0)
    assert cost == pytest.approx(tree.costs[cell_of(space, weights.shape, start)])


def test_a_circle_is_gone_round_the_shorter_side_and_a_limit_is_not_crossed():
    ends = np.array([[0.0, -3.0], [0.0, 3.0]])
    limited = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, False))
    for space, length in ((SPACE, 2.0 * np.pi - 6.0), (limited, 6.0)):
        cost = paths_to(space, np.ones((16, 64)), ends[1]).costs[cell_of(space, (16, 64), ends[0])]
        assert cost == pytest.approx(length, abs=0.1)


def test_where_no_way_leads_there_is_none():
    weights = np.ones((8, 8))
    weights[2], weights[6] = np.inf, np.inf
    inside, outside = centres(SPACE, (8, 8))[[4 * 8, 0]]
    tree = paths_to(SPACE, weights, inside)
    assert tree.path(outside) is None
    assert tree.path(inside).shape == (1, 2)
    assert np.isinf(paths_to(SPACE, weights, centres(SPACE, (8, 8))[2 * 8]).costs).all()


def test_three_joints_are_searched_alike():
    space = JointSpace((-np.pi,) * 3, (np.pi,) * 3, (True,) * 3)
    tree = paths_to(space, np.ones((12, 12, 12)), (3.0, 3.0, 3.0))
    path = tree.path((-3.0, -3.0, -3.0))
    # One step across all three seams at once.
    assert len(path) == 2
