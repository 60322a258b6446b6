"""RRT-Connect by any world's compiled checks, and ways as sequences of straight pieces.

Source: Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000. A
way is (k, d) rad, straight between neighbours and round the shorter side of circles; its length is Euclidean.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.space import JointSpace
from cspace.workshop import Checker

# States between two looks at whether there is room for more.
_BLOCK = 64

Between = Callable[[], None]


def connect_trees(
    checker: Checker,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    states: NDArray[np.float64],
    *,
    range_rad: float,
    resolution_rad: float,
    between: Between | None = None,
) -> NDArray[np.float64] | None:
    """The way that RRT-Connect finds between two free configurations, (k, d) rad; None without one.

    Args:
        checker: of the scene.
        start: (d,) rad.
        goal: (d,) rad.
        states: (n, d) rad that trees grow towards, in order.
        range_rad: longest step of a tree, the sum over the joints.
        resolution_rad: between states that are looked at, the largest over the joints.
        between: called between blocks of states; may raise to stop, which passes through.
    """
    space = checker.space
    nodes, parents = np.empty((2, 16 * _BLOCK, space.dim)), np.full((2, 16 * _BLOCK), -1, dtype=np.int64)
    nodes[0, 0], nodes[1, 0] = space.wrap(start), space.wrap(goal)
    counts, checks = np.ones(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    side = 0
    for begin in range(0, len(states), _BLOCK):
        block = states[begin : begin + _BLOCK]
        _, side, *joint = checker.grow_trees(
            nodes, parents, counts, checks, block, side, range_rad, resolution_rad
        )
        if joint[0] >= 0:
            halves = [nodes[tree, _to_root(parents[tree], joint[tree])] for tree in (0, 1)]
            return np.concatenate([halves[0][::-1], halves[1][1:]])
        # A tree without room grows no more until it has some.
        if 2 * counts.max() > nodes.shape[1]:
            nodes = np.concatenate([nodes, np.empty_like(nodes)], axis=1)
            parents = np.concatenate([parents, np.full_like(parents, -1)], axis=1)
        if between is not None:
            between()
    return None


def spaced(way: ArrayLike, space: JointSpace, step_rad: float) -> NDArray[np.float64]:
    """The same way in steps of at most ``step_rad``, equal within each of its pieces; corners are kept."""
    rows = np.asarray(way, dtype=np.float64)
    pieces = [rows[:1]]
    for begin, end in pairwise(rows):
        step = space.difference(begin, end)
        count = max(1, int(np.ceil(np.linalg.norm(step) / step_rad)))
        shares = np.arange(1, count)[:, None] / count
        pieces += [space.wrap(begin + shares * step), end[None]]
    return np.concatenate(pieces)


def length_rad(way: ArrayLike, space: JointSpace) -> float:
    """Euclidean length of a way (k, d) rad."""
    rows = np.asarray(way, dtype=np.float64)
    return float(space.distance(rows[:-1], rows[1:]).sum())


def _to_root(parents: NDArray[np.int64], node: int) -> list[int]:
    numbers = [node]
    while parents[numbers[-1]] >= 0:
        numbers.append(int(parents[numbers[-1]]))
    return numbers
