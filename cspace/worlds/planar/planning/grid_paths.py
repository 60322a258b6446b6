"""Near-optimal paths where the scenario is known: the data that path models learn from.

A clearance-weighted tree of ways on an exact grid, shortcuts that are checked exactly, and points at equal
distances along what is left. One tree serves every start of a goal.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.grid_search import WayTree, ways_to
from cspace.workshop import PathSearch
from cspace.worlds.planar.planning.collision import CollisionChecker
from cspace.worlds.planar.planning.free_grid import FreeGrid, cells_per_joint
from cspace.worlds.planar.scene import Scenario

# Cells a joint for two joints; more joints get as many in all.
PATH_CELLS = 256
# A way keeps off obstacles up to here, where it costs up to twice as much.
MARGIN_RAD = 0.12
RESOLUTION_RAD = 0.00314

EdgeCheck = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


def clearance_weights(
    clearance_rad: NDArray[np.float64], margin_rad: float = MARGIN_RAD
) -> NDArray[np.float64]:
    """Cost of a rad by its clearance: 1 beyond the margin, up to 2 at contact, inf in collision.

    Args:
        clearance_rad: distance of each cell to the nearest colliding one, 0 in collision.
        margin_rad: above 0.
    """
    near = 1.0 + np.maximum(0.0, 1.0 - clearance_rad / margin_rad)
    return np.where(clearance_rad > 0.0, near, np.inf)


class PathFinder:
    """Near-optimal paths to one goal of a scenario.

    Args:
        scenario: known in full.
        goal: (d,) rad.
        cells: of the grid, as for two joints; of no meaning where the grid is given.
        resolution_rad: largest distance in any joint between the states of a path that are checked.
        grid: the scenario's, where further goals have been asked of it before.

    Raises:
        ScenarioError: the goal is in collision.
    """

    def __init__(
        self,
        scenario: Scenario,
        goal: ArrayLike,
        cells: int = PATH_CELLS,
        resolution_rad: float = RESOLUTION_RAD,
        grid: FreeGrid | None = None,
    ) -> None:
        self._space, self._checker = scenario.robot.space, CollisionChecker(scenario)
        self._goal = self._space.wrap(goal)
        self._resolution_rad = resolution_rad
        if not self._checker.valid(self._goal):
            raise ScenarioError("the goal is in collision", expected="a free configuration", got=str(goal))
        grid = grid or FreeGrid(scenario, cells_per_joint(scenario.robot.dim, cells))
        self._tree: WayTree = ways_to(self._space, clearance_weights(grid.clearance_rad), self._goal)

    def path_from(self, start: ArrayLike) -> NDArray[np.float64] | None:
        """A free path (k, d) rad from ``start`` (d,) to the goal; None where the grid has none.

        Every edge is free at the resolution. A way of the grid whose cells are free and whose edges are not
        is no path, so that a passage finer than a cell may be missed; one that is found is always free.
        """
        way = self._tree.way(start)
        if way is None:
            return None
        corners = np.concatenate([[self._space.wrap(start)], way[1:-1], [self._goal]])
        return shortcut(corners, self._edges_free)

    def _edges_free(self, starts: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.bool_]:
        return self._checker.edge_batch(starts, ends, self._resolution_rad)


def path_search(scenario: Scenario) -> PathSearch:
    """Paths between any free ends of a scenario, found on one grid."""
    grid = FreeGrid(scenario, cells_per_joint(scenario.robot.dim, PATH_CELLS))
    return lambda start, goal: PathFinder(scenario, goal, grid=grid).path_from(start)


def shortcut(path: NDArray[np.float64], edges_free: EdgeCheck) -> NDArray[np.float64] | None:
    """The path without the corners that are not needed, from the start on always to the farthest in sight.

    Args:
        path: (k, d) rad.
        edges_free: (n, d) and (n, d) to which edges are free, (n,).

    Returns:
        (k', d) rad, every edge of which is free; None where a corner has no free edge to any after it.
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
