"""The compiled half of planning, shared by all simulators."""

import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit

TWO_PI = 2.0 * np.pi


@njit(cache=True, nogil=True, error_model="numpy")
def gap(begin, end, wraps):  # type: ignore[no-untyped-def]
    """The way from one angle to another, the shorter one on a circle."""
    found = end - begin
    return (found + np.pi) % TWO_PI - np.pi if wraps else found


def cheapest_route(costs: NDArray[np.float64], start: int, goal: int) -> NDArray[np.int64] | None:
    """Nodes from start to goal at the least cost; None where there is no way.

    Source: Dijkstra, A Note on Two Problems in Connexion with Graphs, 1959, for few nodes with many edges.

    Args:
        costs: (n, n) of edges, 0 or more, inf where there is none.
        start: its number.
        goal: likewise.
    """
    before = _before(costs, start, goal)
    route = [goal]
    while route[-1] != start:
        if before[route[-1]] < 0:
            return None
        route.append(int(before[route[-1]]))
    return np.array(route[::-1], dtype=np.int64)


@njit(cache=True, nogil=True)
def _before(costs, start, goal):  # type: ignore[no-untyped-def]
    """The node before each on its way from the start, (n,); -1 where none is known."""
    count = len(costs)
    reached, done = np.full(count, np.inf), np.zeros(count, dtype=np.bool_)
    before = np.full(count, -1, dtype=np.int64)
    reached[start] = 0.0
    for _ in range(count):
        at = -1
        for node in range(count):
            if not done[node] and (at < 0 or reached[node] < reached[at]):
                at = node
        if at == goal or np.isinf(reached[at]):
            break
        done[at] = True
        for node in range(count):
            onward = reached[at] + costs[at, node]
            if onward < reached[node]:
                reached[node], before[node] = onward, at
    return before
