"""Data sets of paths: for each scenario several pairs of start and goal, each with a near-optimal path.

The first scenarios have a narrow passage between every start and its goal, the others are drawn at random. A
path's points lie at equal distances along it. Where the paths come from is a choice: the world's own search,
or OMPL's RRT* with a limit in time, as in the MultiWGAN-GP paper (section 4).
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import DatasetError
from cspace.planning.paths import spread_points
from cspace.simulator import NARROW, UNIFORM, PathSearch, Problem, Simulator, Split, scenario_rng
from cspace.world import Scene
from cspace.worlds import simulator_of
from services.planner.ompl_planner import solve
from services.planner.result import RRT_STAR, PlannerSettings
from training.data.config import PathDatasetConfig, Shard
from training.data.configurations import Recipe

MAX_DRAWS = 5000
_PROPOSALS = 1000
# Pairs of one scenario that are tried for each one that is wanted.
_TRIES_PER_PAIR = 8


class PathRecipe(Recipe):
    """Data sets of paths."""

    config: PathDatasetConfig

    def __init__(self, config: PathDatasetConfig) -> None:
        rows = config.free_per_scenario + config.pairs_per_scenario * config.points_per_path
        super().__init__(config, rows * config.world.dim)

    def plan(self) -> list[Shard]:
        """Ranges of scenarios."""
        if self.config.narrow_count:
            simulator_of(self.config.world).require(NARROW)
        return super().plan()

    def row(self, index: int, extra: bool) -> dict[str, NDArray[Any]]:
        """A picture, the scene's arrays, free (f, d) and paths (pairs, points, d)."""
        del extra
        return _scenario_with_paths(self.config, index)


def _scenario_with_paths(config: PathDatasetConfig, index: int) -> dict[str, NDArray[Any]]:
    """The first scenario of the index's own stream in which enough paths are found."""
    rng = scenario_rng(Split(config.split), config.seed, index)
    simulator = simulator_of(config.world)
    for _ in range(MAX_DRAWS):
        scene = simulator.scene(rng, Split(config.split), index)
        proposals = config.world.space.sample_uniform(rng, _PROPOSALS)
        free = proposals[simulator.checker(scene).valid_batch(proposals)]
        if len(free) < max(2, config.free_per_scenario):
            continue
        ends = _ends(config, simulator, scene, free, rng, narrow=index < config.narrow_count)
        search = simulator.path_search(scene) if config.source == "grid" else _asymptotic(config, scene, rng)
        paths = _paths(config, search, ends)
        if len(paths) == config.pairs_per_scenario:
            return {
                "images": simulator.render(scene),
                **simulator.arrays_of(scene),
                "free": free[: config.free_per_scenario],
                "paths": np.stack(paths),
            }
    raise DatasetError(
        "no scenario with enough paths was found",
        expected=f"{config.pairs_per_scenario} paths in one of {MAX_DRAWS} draws",
        got=f"none for scenario {index}",
        remedy="ask for fewer pairs, or for a longer time limit",
    )


def _ends(
    config: PathDatasetConfig,
    simulator: Simulator,
    scene: Scene,
    free: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    narrow: bool,
) -> Iterable[NDArray[np.float64]]:
    """Starts and goals (2, d) rad, more than are wanted."""
    count = _TRIES_PER_PAIR * config.pairs_per_scenario
    if not narrow:
        return simulator.ends(scene, free, rng, count)
    pairs = simulator.narrow_pairs(scene, free)
    return free[pairs[rng.integers(len(pairs), size=count)] if len(pairs) else pairs]


def _paths(
    config: PathDatasetConfig, search: PathSearch, ends: Iterable[NDArray[np.float64]]
) -> list[NDArray[np.float64]]:
    """Points (points, d) along paths between as many of the ends (2, d) as are wanted and have one."""
    found: list[NDArray[np.float64]] = []
    for start, goal in ends:
        path = search(start, goal)
        if path is not None and len(path) > 1:
            found.append(spread_points(path, config.points_per_path, config.world.space))
        if len(found) == config.pairs_per_scenario:
            break
    return found


def _asymptotic(config: PathDatasetConfig, scene: Scene, rng: np.random.Generator) -> PathSearch:
    """The path that RRT* holds when its time is over."""

    def search(start: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64] | None:
        problem = Problem(scene, start, goal, UNIFORM, float("nan"), config.seed, 0)
        settings = PlannerSettings(
            planner=RRT_STAR,
            time_limit_s=config.time_limit_s,
            max_iterations=2**31 - 1,
            seed=int(rng.integers(2**32)),
            stop_at_first=False,
        )
        result = solve(problem, settings)
        return result.path if result.solved else None

    return search
