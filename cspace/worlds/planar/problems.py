"""Planning problems of a scenario by family, and the grid of its joint space that tells them apart."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from cspace.errors import ScenarioError
from cspace.simulator import NARROW, UNIFORM, Problem, Split, scenario_rng
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import DiscScenes, Scenario, Scenes


def distance_to_false(
    inside: NDArray[np.bool_], spacing: Sequence[float] | NDArray[np.float64], wraps: Sequence[bool]
) -> NDArray[np.float64]:
    """Distance of each cell's centre to that of the nearest False cell, round axes that wrap; inf without."""
    if inside.all():
        return np.full(inside.shape, np.inf)
    # Half a turn on either side shows both ways round a circle.
    beside = [size // 2 if circle else 0 for size, circle in zip(inside.shape, wraps, strict=True)]
    wide = np.pad(inside, [(one, one) for one in beside], mode="wrap")
    found = ndimage.distance_transform_edt(wide, sampling=spacing)
    own = tuple(slice(one, one + size) for one, size in zip(beside, inside.shape, strict=True))
    return np.asarray(found[own], dtype=np.float64)


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
        space = self.scenario.robot.space
        return np.subtract(space.upper, space.lower) / self.cells

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """The centres of all cells in their order, (n, d) rad."""
        index = np.stack(np.meshgrid(*[np.arange(self.cells)] * self.scenario.robot.dim, indexing="ij"), -1)
        at = index.reshape(-1, self.scenario.robot.dim) + 0.5
        return np.asarray(np.asarray(self.scenario.robot.space.lower) + at * self.spacing_rad)

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        found = CollisionChecker(self.scenario).valid_batch(self.centres)
        return np.reshape(found, (self.cells,) * self.scenario.robot.dim)

    @cached_property
    def touching(self) -> NDArray[np.int64]:
        """Component of each free cell, those that touch in a corner connected; 0 for the others."""
        return self.components(diagonal=True)

    @cached_property
    def clearance_rad(self) -> NDArray[np.float64]:
        """Torus distance from each cell to the nearest colliding one; inf where nothing collides."""
        return distance_to_false(self.free, self.spacing_rad, self.scenario.robot.space.periodic)

    def cells_of(self, configurations: ArrayLike) -> tuple[NDArray[np.int64], ...]:
        """The cells that hold configurations (..., d) rad, or are nearest, as an index: d arrays (...)."""
        space = self.scenario.robot.space
        at = np.floor((space.wrap(configurations) - np.asarray(space.lower)) / self.spacing_rad)
        return tuple(np.moveaxis(np.clip(at.astype(np.int64), 0, self.cells - 1), -1, 0))

    def components(self, above_rad: float = 0.0, *, diagonal: bool = False) -> NDArray[np.int64]:
        """Component of each cell of larger clearance, 0 for the others; corners join if ``diagonal``."""
        inside = self.free if above_rad <= 0.0 else self.clearance_rad > above_rad
        dim = inside.ndim
        structure = ndimage.generate_binary_structure(dim, dim if diagonal else 1)
        labels, count = ndimage.label(inside, structure)
        return self._close_seams(np.asarray(labels, dtype=np.int64), int(count), diagonal=diagonal)

    def joined(self, start: ArrayLike, goal: ArrayLike, above_rad: float = 0.0) -> bool:
        """Whether two configurations lie in one component; False when either's cell is outside."""
        labels = self.components(above_rad)
        first, second = labels[self.cells_of(start)], labels[self.cells_of(goal)]
        return bool(first == second and first > 0)

    def bottleneck_rad(self, start: ArrayLike, goal: ArrayLike) -> float:
        """Largest clearance at which start and goal stay connected, by bisection; 0 when they never are."""
        if not self.joined(start, goal):
            return 0.0
        low, high = 0.0, float(min(self.clearance_rad[self.cells_of(q)] for q in (start, goal)))
        if math.isinf(high) or self.joined(start, goal, high * (1.0 - 1e-9)):
            return high
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            low, high = (middle, high) if self.joined(start, goal, middle) else (low, middle)
        return low

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


class PathFinder:
    """Near-optimal paths of a scenario that is known in full, on one grid of its joint space."""

    def __init__(self, scenario: Scenario, cells: int = PATH_CELLS) -> None:
        self._space, self._checker = scenario.robot.space, CollisionChecker(scenario)
        self._grid = FreeGrid(scenario, cells_per_joint(scenario.robot.dim, cells))
        self._graph = _graph(self._grid)

    def path(self, start: ArrayLike, goal: ArrayLike) -> NDArray[np.float64] | None:
        """A free path (k, d) rad from ``start`` (d,) to ``goal`` (d,); None where the grid has none."""
        first, last = self._space.wrap(start), self._space.wrap(goal)
        shape = self._grid.free.shape
        at, end = (int(np.ravel_multi_index(self._grid.cells_of(q), shape)) for q in (first, last))
        parents = dijkstra(self._graph, directed=False, indices=end, return_predecessors=True)[1]
        cells = [at]
        while cells[-1] != end:
            if parents[cells[-1]] < 0:
                return None
            cells.append(int(parents[cells[-1]]))
        corners = self._grid.centres[cells[1:-1]]
        return _shortcut(np.concatenate([[first], corners, [last]]), self._checker)


def _graph(grid: FreeGrid) -> Any:
    """Free cells and their neighbours by the cost of the way between: a rad costs 1 to 2, by clearance."""
    near = 1.0 + np.maximum(0.0, 1.0 - grid.clearance_rad / MARGIN_RAD)
    wraps, shape = grid.scenario.robot.space.periodic, grid.free.shape
    numbers, axes = np.arange(near.size).reshape(shape), tuple(range(near.ndim))
    edges = []
    for step in itertools.product((-1, 0, 1), repeat=near.ndim):
        # Each pair of neighbours once.
        if step <= (0,) * near.ndim:
            continue
        there = np.roll(numbers, [-one for one in step], axes)
        joined = grid.free & grid.free.ravel()[there]
        for axis, one in enumerate(step):
            if one and not wraps[axis]:
                np.moveaxis(joined, axis, 0)[-1 if one > 0 else 0] = False
        costs = np.linalg.norm(step * grid.spacing_rad) * 0.5 * (near + near.ravel()[there])
        edges.append((numbers[joined], there[joined], costs[joined]))
    rows, columns, values = (np.concatenate(parts) for parts in zip(*edges, strict=True))
    return coo_array((values, (rows, columns)), shape=(near.size, near.size)).tocsr()


def _shortcut(path: NDArray[np.float64], checker: CollisionChecker) -> NDArray[np.float64] | None:
    """The path (k, d) rad, from the start on always to the farthest corner that a free edge leads to."""
    kept, at = [0], 0
    while at < len(path) - 1:
        ahead = path[at + 1 :]
        free = checker.edge_batch(np.broadcast_to(path[at], ahead.shape), ahead, RESOLUTION_RAD)
        if not free.any():
            return None
        at += 1 + int(np.flatnonzero(free)[-1])
        kept.append(at)
    return path[kept]


NARROW_RAD = (0.03, 0.08)
MAX_DRAWS, MAX_OWN_DRAWS = 5000, 200
# Coarse grids tell most scenarios from the narrow family for a tenth of the cost.
_SCREEN_CELLS = (128, 256)
_PROPOSALS = 1000


class Family(StrEnum):
    """What a problem is like."""

    UNIFORM = UNIFORM
    NARROW = NARROW
    DISCONNECTED = "disconnected"


def draw_problem(
    family: Family,
    split: Split,
    seed: int,
    index: int = 0,
    robot: PlanarArm = TWO_LINK,
    scenes: Scenes = DiscScenes(),  # noqa: B008 - a frozen value
) -> Problem:
    """Draw scenarios with start and goal until one belongs to the family, which the robot has to have."""
    family, rng = Family(family), scenario_rng(split, seed, index)
    draws = MAX_DRAWS if scenes == DiscScenes() else MAX_OWN_DRAWS
    for rejected in range(draws):
        scenario = Scenario.from_array(robot, scenes.draw(rng, split, None))
        proposals = robot.space.sample_uniform(rng, _PROPOSALS)
        free = proposals[CollisionChecker(scenario).valid_batch(proposals)]
        found = _ends(family, scenario, free, rng)
        if found is not None:
            ends, bottleneck = found
            ends.setflags(write=False)
            return Problem(scenario, ends[0], ends[1], family, bottleneck, seed, rejected)
    raise ScenarioError(
        f"no {family} problem was found in {draws} draws", remedy="another family, or another robot"
    )


def apart(scenario: Scenario, ends: NDArray[np.float64]) -> str | None:
    """A sentence if ends (2, d) rad lie in different parts of the free space; None where they may not."""
    grid = _fine(scenario)
    first, second = grid.touching[grid.cells_of(ends)]
    if 0 in (first, second) or first == second:
        return None
    cell_rad = float(grid.spacing_rad.max())
    return f"start and goal lie in parts of the free space that are apart (cells of {cell_rad:.3f} rad)"


def _ends(
    family: Family, scenario: Scenario, free: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], float] | None:
    """Start and goal (2, d) rad of the family among free (n, d), and their bottleneck in rad, or None."""
    if len(free) < 2:
        return None
    if family is Family.NARROW:
        pairs = narrow_pairs(scenario, free)
        if not len(pairs):
            return None
        ends = free[pairs[rng.integers(len(pairs))]]
        return ends, _fine(scenario).bottleneck_rad(*ends)
    grid, ends = _fine(scenario), free[:2].copy()
    if family is Family.DISCONNECTED:
        # Cells that touch in a corner count as connected here: no path may hide between two cells.
        first, second = grid.touching[grid.cells_of(ends)]
        return (ends, 0.0) if first > 0 and second > 0 and first != second else None
    bottleneck = grid.bottleneck_rad(*ends)
    return (ends, bottleneck) if bottleneck > 0.0 else None


def narrow_pairs(scenario: Scenario, configurations: NDArray[np.float64]) -> NDArray[np.int64]:
    """All pairs (k, 2) of free configurations (n, d) rad that a narrow passage joins and nothing wider."""
    low, high = NARROW_RAD
    for cells in _SCREEN_CELLS:
        grid = FreeGrid(scenario, cells)
        sides, whole = _sides(grid, configurations, 0.0, high + float(grid.spacing_rad.max()) / 2.0)
        kinds = np.unique(np.stack([whole, sides])[:, sides > 0], axis=1)
        if len(np.unique(kinds[0])) == kinds.shape[1]:
            return np.empty((0, 2), dtype=np.int64)
    sides, whole = _sides(_fine(scenario), configurations, low, high)
    return np.argwhere(
        (sides[:, None] != sides) & (whole[:, None] == whole) & (sides[:, None] > 0) & (sides > 0)
    )


def _sides(
    grid: FreeGrid, free: NDArray[np.float64], low: float, high: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each configuration's component at clearance ``high`` and at ``low``, (n,) each; 0 is none."""
    cells = grid.cells_of(free)
    return grid.components(high)[cells], grid.components(low, diagonal=low == 0.0)[cells]


def resolves_narrow(robot: PlanarArm) -> bool:
    """Whether a robot's grid is as fine as narrow passages."""
    widest_rad = np.max(np.subtract(robot.space.upper, robot.space.lower))
    return bool(widest_rad / cells_per_joint(robot.dim) <= NARROW_RAD[1])


# Given scenes are drawn from again and again.
@lru_cache(maxsize=1)
def _fine(scenario: Scenario) -> FreeGrid:
    return FreeGrid(scenario, cells_per_joint(scenario.robot.dim))
