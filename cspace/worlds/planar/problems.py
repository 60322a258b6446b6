"""Planning problems: seeded start and goal in a scenario, by family."""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.simulator import NARROW, UNIFORM, Problem, Split, scenario_rng
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.free_grid import FreeGrid, cells_per_joint
from cspace.worlds.planar.scenes import DiscScenes, Scenes
from cspace.worlds.planar.world import Scenario, random_scenario

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
    """Draw scenarios with start and goal until one belongs to the family.

    Args:
        family: which.
        split: what the problem may be used for.
        seed: of the problem set.
        index: of the problem within it.
        robot: the arm.
        scenes: where its obstacles come from.

    Raises:
        ScenarioError: none was found in 5000 draws, or in 200 of scenes of one's own.
    """
    family, rng = Family(family), scenario_rng(split, seed, index)
    if family is Family.NARROW:
        require_resolution(robot)
    draws = MAX_DRAWS if scenes == DiscScenes() else MAX_OWN_DRAWS
    for rejected in range(draws):
        scenario = random_scenario(rng, robot, scenes, split)
        proposals = robot.space.sample_uniform(rng, _PROPOSALS)
        free = proposals[CollisionChecker(scenario).valid_batch(proposals)]
        found = _search(family, scenario, free, rng)
        if found is not None:
            for end in (found.start, found.goal):
                end.setflags(write=False)
            return Problem(scenario, found.start, found.goal, family, found.bottleneck_rad, seed, rejected)
    raise ScenarioError(
        f"no {family} problem was found",
        expected=f"one in {draws} draws",
        got="none",
        remedy="another family, or another robot",
    )


def connected(scenario: Scenario, start: ArrayLike, goal: ArrayLike) -> bool:
    """Whether a path exists, by flood fill on the fine grid."""
    return _fine(scenario).joined(start, goal)


def bottleneck_rad(scenario: Scenario, start: ArrayLike, goal: ArrayLike) -> float:
    """Largest clearance, in rad on the torus, at which start and goal stay connected; 0 without a path."""
    return _fine(scenario).bottleneck_rad(start, goal)


def obstruction(scenario: Scenario, start: ArrayLike, goal: ArrayLike) -> str | None:
    """Why there is no path, in words; None where there may be one.

    Start or goal collides, or they lie in different parts of the free space, as in the family
    ``disconnected``: cells that touch in a corner count as joined, so that no path hides between two cells.
    """
    checker, ends = CollisionChecker(scenario), np.array([start, goal], dtype=np.float64)
    for name, clearance_m in zip(("start", "goal"), checker.clearance(ends), strict=True):
        if clearance_m <= 0.0:
            return f"the {name} is {-clearance_m:.3f} m deep in collision"
    grid = _fine(scenario)
    first, second = grid.touching[grid.cells_of(ends)]
    if 0 not in (first, second) and first != second:
        cell_rad = float(grid.spacing_rad.max())
        return f"start and goal lie in parts of the free space that are apart (cells of {cell_rad:.3f} rad)"
    return None


@dataclass(frozen=True, slots=True)
class _Ends:
    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    bottleneck_rad: float


def _search(
    family: Family, scenario: Scenario, free: NDArray[np.float64], rng: np.random.Generator
) -> _Ends | None:
    """Ends of the family among free configurations (n, d), None when there are none."""
    if len(free) < 2:
        return None
    if family is Family.NARROW:
        return _narrow_ends(scenario, free, rng)
    grid, (start, goal) = _fine(scenario), free[:2].copy()
    if family is Family.DISCONNECTED:
        # Cells that touch in a corner count as connected here: no path may hide between two cells.
        first, second = grid.touching[grid.cells_of(free[:2])]
        return _Ends(start, goal, 0.0) if first > 0 and second > 0 and first != second else None
    bottleneck = grid.bottleneck_rad(start, goal)
    return _Ends(start, goal, bottleneck) if bottleneck > 0.0 else None


def narrow_pairs(
    scenario: Scenario, configurations: NDArray[np.float64]
) -> tuple[FreeGrid, NDArray[np.int64]] | None:
    """All pairs of free configurations that a narrow passage joins and nothing wider.

    Args:
        scenario: the arm among its discs.
        configurations: (n, d) rad, free.

    Returns:
        The fine grid, and indices (k, 2) of starts and goals; None where there is no such pair.
    """
    low, high = NARROW_RAD
    for cells in _SCREEN_CELLS:
        grid = FreeGrid(scenario, cells)
        if not _passages(grid, configurations, 0.0, high + float(grid.spacing_rad.max()) / 2.0):
            return None
    grid = _fine(scenario)
    if not _passages(grid, configurations, low, high):
        return None
    sides, whole = _sides(grid, configurations, low, high)
    pairs = np.argwhere(
        (sides[:, None] != sides) & (whole[:, None] == whole) & (sides[:, None] > 0) & (sides > 0)
    )
    return grid, pairs


def _narrow_ends(scenario: Scenario, free: NDArray[np.float64], rng: np.random.Generator) -> _Ends | None:
    """A pair drawn evenly from all pairs of ``free`` that a narrow passage joins and nothing wider."""
    found = narrow_pairs(scenario, free)
    if found is None:
        return None
    grid, pairs = found
    start, goal = free[pairs[rng.integers(len(pairs))]]
    return _Ends(start.copy(), goal.copy(), grid.bottleneck_rad(start, goal))


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
    """Refuse narrow passages of a robot whose grid is too coarse for them.

    Raises:
        ScenarioError: it is.
    """
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
