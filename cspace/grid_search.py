"""Shortest ways on a grid whose axes may wrap: one tree of all ways to a goal.

Dijkstra's algorithm over cells and all their neighbours, diagonal ones included; a step costs its length
times the mean weight of its two cells.
"""

import itertools
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.space import JointSpace


@dataclass(frozen=True, eq=False)
class WayTree:
    """The cheapest way from every cell to the goal's.

    Args:
        space: the joint space, cut into cells of equal size.
        costs: (cells, ...) of the way from each cell, rad times weight; inf where there is none.
        parents: (cells, ...) number of the next cell on the way; -1 at the goal and where there is none.
    """

    space: JointSpace
    costs: NDArray[np.float64]
    parents: NDArray[np.int64]

    def way(self, start: ArrayLike) -> NDArray[np.float64] | None:
        """Centres of the cells from that of ``start`` (d,) to the goal's, (k, d) rad; None without a way."""
        at = int(np.ravel_multi_index(cell_of(self.space, self.costs.shape, start), self.costs.shape))
        if not np.isfinite(self.costs.flat[at]):
            return None
        numbers = [at]
        parents = self.parents.ravel()
        while parents[numbers[-1]] >= 0:
            numbers.append(int(parents[numbers[-1]]))
        cells = np.stack(np.unravel_index(numbers, self.costs.shape), axis=-1)
        return np.asarray(
            np.asarray(self.space.lower) + (cells + 0.5) * spacing(self.space, self.costs.shape)
        )


def spacing(space: JointSpace, cells: tuple[int, ...]) -> NDArray[np.float64]:
    """Size of a cell along each joint, (d,) rad."""
    return np.asarray(np.subtract(space.upper, space.lower) / cells, dtype=np.float64)


def centres(space: JointSpace, cells: tuple[int, ...]) -> NDArray[np.float64]:
    """The centres of all cells in their order, (n, d) rad."""
    index = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, len(cells))
    return np.asarray(np.asarray(space.lower) + (index + 0.5) * spacing(space, cells))


def cells_of(
    space: JointSpace, cells: tuple[int, ...], configurations: ArrayLike
) -> tuple[NDArray[np.int64], ...]:
    """The cells that hold configurations (..., d) rad, or are nearest, as an index: d arrays (...)."""
    offset = (space.wrap(configurations) - np.asarray(space.lower)) / spacing(space, cells)
    found: NDArray[np.int64] = np.clip(np.floor(offset).astype(np.int64), 0, np.asarray(cells) - 1)
    return tuple(np.moveaxis(found, -1, 0))


def cell_of(space: JointSpace, cells: tuple[int, ...], configuration: ArrayLike) -> tuple[int, ...]:
    """The cell that holds a configuration (d,) rad; for one outside the limits the nearest."""
    return tuple(int(index) for index in cells_of(space, cells, configuration))


def ways_to(space: JointSpace, weights: NDArray[np.float64], goal: ArrayLike) -> WayTree:
    """The tree of all ways to a goal.

    Args:
        space: the joint space.
        weights: (cells, ...) cost of a rad in each cell, above 0; inf where no way may pass.
        goal: (d,) rad; a goal in a cell where no way may pass has none.
    """
    shape = weights.shape
    steps = np.array([step for step in itertools.product((-1, 0, 1), repeat=len(shape)) if any(step)])
    lengths = np.linalg.norm(steps * spacing(space, shape), axis=1)
    source = int(np.ravel_multi_index(cell_of(space, shape, goal), shape))
    costs, parents = _grow(
        np.ascontiguousarray(weights, dtype=np.float64).ravel(),
        np.array(shape, dtype=np.int64),
        np.array(space.periodic, dtype=np.bool_),
        steps.astype(np.int64),
        lengths,
        source,
    )
    return WayTree(space, costs.reshape(shape), parents.reshape(shape))


@njit(cache=True, nogil=True)
def _grow(weights, shape, wraps, steps, lengths, source):  # type: ignore[no-untyped-def]
    dim = shape.shape[0]
    costs = np.full(weights.shape[0], np.inf)
    parents = np.full(weights.shape[0], -1, dtype=np.int64)
    if weights[source] == np.inf:
        return costs, parents
    costs[source] = 0.0
    heap = [(0.0, source)]
    place = np.empty(dim, dtype=np.int64)
    while len(heap) > 0:
        cost, cell = heappop(heap)
        if cost > costs[cell]:
            continue
        rest = cell
        for axis in range(dim - 1, -1, -1):
            place[axis] = rest % shape[axis]
            rest //= shape[axis]
        for step in range(steps.shape[0]):
            neighbour, inside = 0, True
            for axis in range(dim):
                at = place[axis] + steps[step, axis]
                if at < 0 or at >= shape[axis]:
                    inside = inside and wraps[axis]
                    at %= shape[axis]
                neighbour = neighbour * shape[axis] + at
            if not inside or weights[neighbour] == np.inf:
                continue
            through = cost + lengths[step] * 0.5 * (weights[cell] + weights[neighbour])
            if through < costs[neighbour]:
                costs[neighbour] = through
                parents[neighbour] = cell
                heappush(heap, (through, neighbour))
    return costs, parents
