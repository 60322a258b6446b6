"""Data sets of paths: for each scenario several pairs of start and goal, each with a near-optimal path.

The first scenarios have a narrow passage between every start and its goal, the others are drawn at random. A
path's points lie at equal distances along it. Where the paths come from is a choice: the exact grid of
:mod:`cspace.worlds.planar.grid_paths`, or OMPL's RRT* with a limit in time, as in the MultiWGAN-GP paper
(section 4).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, write_dataset
from cspace.errors import DatasetError
from cspace.path_points import spread_points
from cspace.problem import Problem
from cspace.splits import Split, scenario_rng
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.free_grid import FreeGrid, cells_per_joint
from cspace.worlds.planar.grid_paths import PATH_CELLS, PathFinder
from cspace.worlds.planar.problems import Family, narrow_pairs, require_resolution
from cspace.worlds.planar.render import render
from cspace.worlds.planar.scene import Scenario, random_scenario
from services.planner.search.ompl_planner import solve
from services.planner.settings import RRT_STAR, PlannerSettings
from training.datasets.config import PathDatasetConfig
from training.datasets.recipe import Arrays
from training.datasets.shards import Shard

MAX_DRAWS = 5000
_PROPOSALS = 1000
# Pairs of one scenario that are tried for each one that is wanted.
_TRIES_PER_PAIR = 8

Ends = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class PathRecipe:
    """See :class:`training.datasets.recipe.Recipe`."""

    config: PathDatasetConfig

    @property
    def key(self) -> str:
        """Of the configuration."""
        return self.config.key

    @property
    def finished_bytes(self) -> int:
        """Of pictures, configurations and paths."""
        config = self.config
        rows = config.free_per_scenario + config.pairs_per_scenario * config.points_per_path
        each = math.prod(config.world.sensor.picture_shape) + rows * 4 * config.world.dim
        return config.scenario_count * each

    def plan(self) -> list[Shard]:
        """Ranges of scenarios.

        Raises:
            ScenarioError: narrow passages are asked for, and the robot's grid is too coarse for them.
        """
        if self.config.narrow_count:
            require_resolution(self.config.world.body)
        total, size = self.config.scenario_count, self.config.shard_size
        return [Shard(first, min(size, total - first), extra=False) for first in range(0, total, size)]

    def make(self, shard: Shard) -> dict[str, NDArray[Any]]:
        """Pictures (n, P, P, 3), discs (n, D, 3), free (n, f, d) and paths (n, pairs, points, d)."""
        rows = [
            _scenario_with_paths(self.config, index)
            for index in range(shard.first, shard.first + shard.count)
        ]
        names = ("images", "discs", "free", "paths")
        return {name: np.stack([row[name] for row in rows]) for name in names}

    def write(self, folder: Path, load: Callable[[Shard], Arrays]) -> Dataset:
        """See :func:`cspace.dataset.write_dataset`."""
        parts = [load(shard) for shard in self.plan()]
        paths = np.concatenate([part["paths"] for part in parts])
        return write_dataset(
            folder,
            world=self.config.world,
            images=np.concatenate([part["images"] for part in parts]),
            free=[free for part in parts for free in part["free"]],
            paths=[(scenario, path) for scenario, of_one in enumerate(paths) for path in of_one],
            scenes={"discs": np.concatenate([part["discs"] for part in parts])},
            generator=self.config.model_dump(mode="json"),
        )


def _scenario_with_paths(config: PathDatasetConfig, index: int) -> dict[str, NDArray[Any]]:
    """The first scenario of the index's own stream in which enough paths are found."""
    rng = scenario_rng(Split(config.split), config.seed, index)
    narrow = index < config.narrow_count
    for _ in range(MAX_DRAWS):
        scenario = random_scenario(rng, config.world.body)
        proposals = scenario.robot.space.sample_uniform(rng, _PROPOSALS)
        free = proposals[CollisionChecker(scenario).valid_batch(proposals)]
        if len(free) < max(2, config.free_per_scenario):
            continue
        paths = _paths(config, scenario, _pairs(config, scenario, free, rng, narrow=narrow), rng)
        if len(paths) == config.pairs_per_scenario:
            return {
                "images": render(scenario),
                "discs": scenario.disc_array,
                "free": free[: config.free_per_scenario],
                "paths": np.stack(paths),
            }
    raise DatasetError(
        "no scenario with enough paths was found",
        expected=f"{config.pairs_per_scenario} paths in one of {MAX_DRAWS} draws",
        got=f"none for scenario {index}",
        remedy="ask for fewer pairs, or for a longer time limit",
    )


def _pairs(
    config: PathDatasetConfig,
    scenario: Scenario,
    free: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    narrow: bool,
) -> Iterator[Ends]:
    count = _TRIES_PER_PAIR * config.pairs_per_scenario
    if not narrow:
        for start, goal in rng.integers(len(free), size=(count, 2)):
            yield free[start], free[goal]
        return
    found = narrow_pairs(scenario, free)
    for start, goal in [] if found is None else found[1][rng.integers(len(found[1]), size=count)]:
        yield free[start], free[goal]


def _paths(
    config: PathDatasetConfig, scenario: Scenario, pairs: Iterator[Ends], rng: np.random.Generator
) -> list[NDArray[np.float64]]:
    """Points (points, d) along a path for each of the pairs that has one, no more than are wanted."""
    grid = FreeGrid(scenario, cells_per_joint(scenario.robot.dim, PATH_CELLS))
    found: list[NDArray[np.float64]] = []
    for start, goal in pairs:
        if config.source == "grid":
            path = PathFinder(scenario, goal, grid=grid).path_from(start)
        else:
            path = _asymptotic(config, scenario, (start, goal), int(rng.integers(2**32)))
        if path is not None and len(path) > 1:
            found.append(spread_points(path, config.points_per_path, scenario.robot.space))
        if len(found) == config.pairs_per_scenario:
            break
    return found


def _asymptotic(
    config: PathDatasetConfig, scenario: Scenario, ends: Ends, seed: int
) -> NDArray[np.float64] | None:
    """The path that RRT* holds when its time is over."""
    problem = Problem(scenario, *ends, Family.UNIFORM, float("nan"), config.seed, 0)
    settings = PlannerSettings(
        planner=RRT_STAR,
        time_limit_s=config.time_limit_s,
        max_iterations=2**31 - 1,
        seed=seed,
        stop_at_first=False,
    )
    result = solve(problem, settings)
    return result.path if result.solved else None
