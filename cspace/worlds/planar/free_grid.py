"""The free space on a grid: connectivity, clearance and near-optimal paths; circles are closed."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from cspace.space import JointSpace
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.world import Scenario


def distance_to_false(
    inside: NDArray[np.bool_], spacing: Sequence[float] | NDArray[np.float64], wraps: Sequence[bool]
) -> NDArray[np.float64]:
    """Distance of each cell's centre to that of the nearest False cell; inf where there is none.

    ``wraps``: whether the axis is a circle.
    """
    if inside.all():
        return np.full(inside.shape, np.inf)
    # Half a turn on either side shows both ways round a circle.
    beside = [size // 2 if circle else 0 for size, circle in zip(inside.shape, wraps, strict=True)]
    wide = np.pad(inside, [(one, one) for one in beside], mode="wrap")
    found = ndimage.distance_transform_edt(wide, sampling=spacing)
    own = tuple(slice(one, one + size) for one, size in zip(beside, inside.shape, strict=True))
    return np.asarray(found[own], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PathTree:
    """The cheapest route from every cell to the goal's."""

    space: JointSpace
    # (cells, ...) of the route from each cell, rad times weight; inf where there is none
    costs: NDArray[np.float64]
    # (cells, ...) number of the next cell on the route; -1 at the goal and where there is none
    parents: NDArray[np.int64]

    def path(self, start: ArrayLike) -> NDArray[np.float64] | None:
        """Centres of the cells from ``start`` (d,) to the goal, (k, d) rad; None without a route."""
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


def paths_to(space: JointSpace, weights: NDArray[np.float64], goal: ArrayLike) -> PathTree:
    """The tree of all routes to a goal.

    ``weights``: (cells, ...) cost of a rad in each cell, above 0; inf where no route may pass. ``goal``: (d,)
    rad; a goal in a cell where no route may pass has none.
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
    return PathTree(space, costs.reshape(shape), parents.reshape(shape))


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


# Cells a joint for two joints; more joints get as many cells in all.
FINE_CELLS = 512
_BISECTIONS = 24


def cells_per_joint(dim: int, fine: int = FINE_CELLS) -> int:
    """Cells along each joint of a grid that has ``fine`` squared cells in all."""
    return int(np.round(fine ** (2.0 / dim)))


@dataclass(frozen=True)
class FreeGrid:
    """A scenario's joint space cut into equal cells, each checked at its centre."""

    scenario: Scenario
    cells: int

    @cached_property
    def spacing_rad(self) -> NDArray[np.float64]:
        """Size of a cell along each joint, (d,)."""
        return spacing(self.scenario.robot.space, self._shape)

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Which cells are free, (cells,) * d."""
        points = centres(self.scenario.robot.space, self._shape)
        return np.reshape(CollisionChecker(self.scenario).valid_batch(points), self._shape)

    @cached_property
    def touching(self) -> NDArray[np.int64]:
        """Component of each free cell, those that touch in a corner connected; 0 for the others."""
        return self.components(diagonal=True)

    @cached_property
    def clearance_rad(self) -> NDArray[np.float64]:
        """Torus distance from each cell to the nearest colliding one; inf where nothing collides."""
        return distance_to_false(self.free, self.spacing_rad, self.scenario.robot.space.periodic)

    def cells_of(self, configurations: ArrayLike) -> tuple[NDArray[np.int64], ...]:
        """The cells that hold configurations (..., d) rad, as an index: d arrays (...)."""
        return cells_of(self.scenario.robot.space, self._shape, configurations)

    def cell_of(self, configuration: ArrayLike) -> tuple[int, ...]:
        """The cell that holds a configuration (d,) rad."""
        return tuple(int(index) for index in self.cells_of(configuration))

    def components(self, above_rad: float = 0.0, *, diagonal: bool = False) -> NDArray[np.int64]:
        """Component of each cell whose clearance is above ``above_rad``; 0 for the other cells.

        ``above_rad``: 0 for the free space itself. ``diagonal``: whether cells that touch in a corner are
        connected.
        """
        inside = self.free if above_rad <= 0.0 else self.clearance_rad > above_rad
        dim = inside.ndim
        structure = ndimage.generate_binary_structure(dim, dim if diagonal else 1)
        labels, count = ndimage.label(inside, structure)
        return self._close_seams(np.asarray(labels, dtype=np.int64), int(count), diagonal=diagonal)

    def joined(
        self, start: ArrayLike, goal: ArrayLike, above_rad: float = 0.0, *, diagonal: bool = False
    ) -> bool:
        """Whether two configurations lie in one component; False when either's cell is outside."""
        labels = self.components(above_rad, diagonal=diagonal)
        first, second = labels[self.cell_of(start)], labels[self.cell_of(goal)]
        return bool(first == second and first > 0)

    def bottleneck_rad(self, start: ArrayLike, goal: ArrayLike) -> float:
        """Largest clearance at which start and goal stay connected; 0 when they never are.

        Found by bisection to far below the size of a cell.
        """
        if not self.joined(start, goal):
            return 0.0
        low, high = 0.0, float(min(self.clearance_rad[self.cell_of(q)] for q in (start, goal)))
        if math.isinf(high) or self.joined(start, goal, high * (1.0 - 1e-9)):
            return high
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            low, high = (middle, high) if self.joined(start, goal, middle) else (low, middle)
        return low

    @property
    def _shape(self) -> tuple[int, ...]:
        return (self.cells,) * self.scenario.robot.dim

    def _close_seams(self, labels: NDArray[np.int64], count: int, *, diagonal: bool) -> NDArray[np.int64]:
        pairs = [np.empty((2, 0), dtype=np.int64)]
        for axis, wraps in enumerate(self.scenario.robot.space.periodic):
            if not wraps:
                continue
            first, last = np.take(labels, 0, axis), np.take(labels, -1, axis)
            for shifted in _shifts(last) if diagonal else [last]:
                both = (first > 0) & (shifted > 0)
                pairs.append(np.stack([first[both], shifted[both]]))
        left, right = np.concatenate(pairs, axis=1)
        graph = coo_array((np.ones(len(left)), (left, right)), shape=(count + 1, count + 1))
        merged = np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
        # The ground, label 0, keeps 0 for itself; every other component moves up by one.
        names = np.where(merged == merged[0], 0, merged + 1)
        return names[labels]


def _shifts(face: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """A face and its neighbours by one cell along its axes (corners wrap as well)."""
    result = [face]
    for axis in range(face.ndim):
        result += [np.roll(part, step, axis) for part in tuple(result) for step in (-1, 1)]
    return result


# Cells a joint for two joints; more joints get as many in all.
PATH_CELLS = 256
# A route keeps off obstacles up to here, where it costs up to twice as much.
MARGIN_RAD = 0.12
RESOLUTION_RAD = 0.00314

EdgeCheck = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


def clearance_weights(clearance_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cost of a rad by its clearance: 1 beyond :data:`MARGIN_RAD`, up to 2 at contact, inf in collision.

    ``clearance_rad``: distance of each cell to the nearest colliding one, 0 in collision.
    """
    near = 1.0 + np.maximum(0.0, 1.0 - clearance_rad / MARGIN_RAD)
    return np.where(clearance_rad > 0.0, near, np.inf)


class PathFinder:
    """Near-optimal paths of a scenario that is known in full, on one grid of its joint space."""

    def __init__(self, scenario: Scenario, cells: int = PATH_CELLS) -> None:
        self._space, self._checker = scenario.robot.space, CollisionChecker(scenario)
        grid = FreeGrid(scenario, cells_per_joint(scenario.robot.dim, cells))
        self._weights = clearance_weights(grid.clearance_rad)

    def path(self, start: ArrayLike, goal: ArrayLike) -> NDArray[np.float64] | None:
        """A free path (k, d) rad from ``start`` (d,) to ``goal`` (d,); None where the grid has none.

        Every edge is free at the resolution. A route of the grid whose cells are free and whose edges are not
        is no path, so that a passage finer than a cell may be missed; one that is found is always free.
        """
        first, last = self._space.wrap(start), self._space.wrap(goal)
        if not self._checker.valid(last):
            raise ScenarioError("the goal is in collision", expected="a free configuration", got=str(goal))
        route = paths_to(self._space, self._weights, last).path(first)
        if route is None:
            return None
        return shortcut(np.concatenate([[first], route[1:-1], [last]]), self._edges_free)

    def _edges_free(self, starts: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.bool_]:
        return self._checker.edge_batch(starts, ends, RESOLUTION_RAD)


def shortcut(path: NDArray[np.float64], edges_free: EdgeCheck) -> NDArray[np.float64] | None:
    """The path without the corners that are not needed, from the start on always to the farthest in sight.

    ``path``: (k, d) rad. ``edges_free``: (n, d) and (n, d) to which edges are free, (n,). Returns (k', d)
    rad, every edge of which is free; None where a corner has no free edge to any after it.
    """
    kept, at = [0], 0
    while at < len(path) - 1:
        ahead = path[at + 1 :]
        free = edges_free(np.broadcast_to(path[at], ahead.shape), ahead)
        if not free.any():
            return None
        at += 1 + int(np.flatnonzero(free)[-1])
        kept.append(at)
    return path[kept]
