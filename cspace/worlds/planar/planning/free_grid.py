"""The free space on a grid: connectivity and clearance, with the seams of periodic joints closed."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cspace.grid_search import cells_of, centres, spacing
from cspace.worlds.planar.planning.collision import CollisionChecker
from cspace.worlds.planar.planning.distance import distance_to_false
from cspace.worlds.planar.scene import Scenario

# Cells a joint for two joints; more joints get as many cells in all.
FINE_CELLS = 512
_BISECTIONS = 24


def cells_per_joint(dim: int, fine: int = FINE_CELLS) -> int:
    """Cells along each joint of a grid that has ``fine`` squared cells in all."""
    return int(np.round(fine ** (2.0 / dim)))


@dataclass(frozen=True)
class FreeGrid:
    """A scenario's joint space cut into equal cells, each judged at its centre.

    Args:
        scenario: whose free space.
        cells: along each joint.
    """

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

        Args:
            above_rad: 0 for the free space itself.
            diagonal: whether cells that touch in a corner are connected.
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
