"""Planning problems: seeded start and goal in a scenario, by family."""

from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.simulator import NARROW, UNIFORM, Problem, Split, scenario_rng
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.free_grid import FreeGrid, cells_per_joint
from cspace.worlds.planar.scenes import DiscScenes, Scenes
from cspace.worlds.planar.world import Scenario

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
    """Draw scenarios with start and goal until one belongs to the family."""
    family, rng = Family(family), scenario_rng(split, seed, index)
    if family is Family.NARROW:
        require_resolution(robot)
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
        f"no {family} problem was found",
        expected=f"one in {draws} draws",
        got="none",
        remedy="another family, or another robot",
    )


def apart(scenario: Scenario, ends: NDArray[np.float64]) -> str | None:
    """In words, that ends (2, d) rad lie in different parts of the free space; None where they may not.

    As in the family ``disconnected`` cells that touch in a corner count as joined, so that no path hides
    between two cells.
    """
    grid = _fine(scenario)
    first, second = grid.touching[grid.cells_of(ends)]
    if 0 in (first, second) or first == second:
        return None
    cell_rad = float(grid.spacing_rad.max())
    return f"start and goal lie in parts of the free space that are apart (cells of {cell_rad:.3f} rad)"


def _ends(
    family: Family, scenario: Scenario, free: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], float] | None:
    """Start and goal (2, d) rad of the family among free configurations (n, d), and their bottleneck in rad.

    None where there are none; those of a narrow passage are drawn evenly from all that have one.
    """
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
    """All pairs of free configurations that a narrow passage joins and nothing wider.

    ``configurations``: (n, d) rad, free. Returns indices (k, 2) of starts and goals.
    """
    low, high = NARROW_RAD
    none = np.empty((0, 2), dtype=np.int64)
    for cells in _SCREEN_CELLS:
        grid = FreeGrid(scenario, cells)
        if not _passages(grid, configurations, 0.0, high + float(grid.spacing_rad.max()) / 2.0):
            return none
    grid = _fine(scenario)
    if not _passages(grid, configurations, low, high):
        return none
    sides, whole = _sides(grid, configurations, low, high)
    return np.argwhere(
        (sides[:, None] != sides) & (whole[:, None] == whole) & (sides[:, None] > 0) & (sides > 0)
    )


def _passages(grid: FreeGrid, free: NDArray[np.float64], low: float, high: float) -> bool:
    """Whether some two of ``free`` are joined at clearance ``low`` and apart at ``high``."""
    sides, whole = _sides(grid, free, low, high)
    kinds = np.unique(np.stack([whole, sides])[:, sides > 0], axis=1)
    return bool(len(np.unique(kinds[0])) < kinds.shape[1])


def _sides(
    grid: FreeGrid, free: NDArray[np.float64], low: float, high: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each configuration's component at clearance ``high`` and at ``low``, (n,) each; 0 is none."""
    cells = grid.cells_of(free)
    return grid.components(high)[cells], grid.components(low, diagonal=low == 0.0)[cells]


def resolves_narrow(robot: PlanarArm) -> bool:
    """Whether a robot's grid is as fine as narrow passages."""
    return _cell_rad(robot) <= NARROW_RAD[1]


def _cell_rad(robot: PlanarArm) -> float:
    widest_rad = float(np.max(np.subtract(robot.space.upper, robot.space.lower)))
    return widest_rad / cells_per_joint(robot.dim)


def require_resolution(robot: PlanarArm) -> None:
    """Refuse narrow passages of a robot whose grid is too coarse for them."""
    if not resolves_narrow(robot):
        raise ScenarioError(
            f"narrow passages of {robot.dim} joints are finer than the grid",
            expected=f"cells below {NARROW_RAD[1]} rad",
            got=f"{_cell_rad(robot):.3f} rad",
            remedy="another family, or a robot of two joints",
        )


# Given scenes are drawn from again and again.
@lru_cache(maxsize=1)
def _fine(scenario: Scenario) -> FreeGrid:
    return FreeGrid(scenario, cells_per_joint(scenario.robot.dim))
