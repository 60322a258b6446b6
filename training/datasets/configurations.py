"""Data sets of free and colliding configurations, as a recipe."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, write_dataset
from cspace.errors import DatasetError
from cspace.splits import Split, scenario_rng
from cspace.workshop import Checker
from cspace.world import Arrays
from cspace.worlds import workshop_of
from training.datasets.config import DatasetConfig
from training.datasets.shards import Shard

# Pictures alone come from the same split under indices that no scenario with configurations has.
EXTRA_FIRST_INDEX = 2**31
# Rejection gives up on a scenario whose free (or colliding) share is smaller than one in this many.
MAX_PROPOSALS_PER_SAMPLE = 1000
# Scenes of a family that are tried for one scenario.
MAX_DRAWS = 100
_MIN_ROUND = 64


@dataclass(frozen=True)
class ConfigurationRecipe:
    """How the shards of a configuration are made, anywhere, and put together."""

    config: DatasetConfig

    @property
    def finished_bytes(self) -> int:
        """Of pictures and configurations."""
        config = self.config
        pictures = config.scenario_count + config.extra_image_count
        rows = config.scenario_count * (config.free_per_scenario + config.collision_per_scenario)
        return pictures * math.prod(config.world.sensor.picture_shape) + rows * 8 * config.world.dim

    def plan(self) -> list[Shard]:
        """Scenarios, then pictures alone."""
        config, size = self.config, self.config.shard_size
        return [
            Shard(first, min(size, total - first), extra)
            for extra, total in ((False, config.scenario_count), (True, config.extra_image_count))
            for first in range(0, total, size)
        ]

    def make(self, shard: Shard) -> dict[str, NDArray[Any]]:
        """The arrays of one shard; the same whatever the shards' size and wherever it is computed."""
        offset = EXTRA_FIRST_INDEX if shard.extra else 0
        rows = [self._row(offset + shard.first + place, shard.extra) for place in range(shard.count)]
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}

    def _row(self, index: int, extra: bool) -> dict[str, NDArray[Any]]:
        """One scenario; of a family another one is drawn where hardly anything collides, or all of it."""
        config, split = self.config, Split(self.config.split)
        workshop, rng = workshop_of(config.world), scenario_rng(split, config.seed, index)
        for _ in range(1 if workshop.count(split) else MAX_DRAWS):
            scene = workshop.scene(rng, split, index)
            if extra:
                return {"images": workshop.render(scene)}
            checker = workshop.checker(scene)
            try:
                free = draw_configurations(checker, config.free_per_scenario, rng, free=True)
                collision = draw_configurations(checker, config.collision_per_scenario, rng, free=False)
            except DatasetError as error:
                problem = error
                continue
            return {
                "images": workshop.render(scene),
                **workshop.arrays_of(scene),
                "free": free,
                "collision": collision,
            }
        raise problem

    def write(self, folder: Path, load: Callable[[Shard], Arrays]) -> Dataset:
        """See :func:`cspace.dataset.write_dataset`."""
        shards = self.plan()
        scenes, extras = ([load(s) for s in shards if s.extra is extra] for extra in (False, True))
        known = self.config.world.scene_files
        collision = [part for scene in scenes for part in scene["collision"]]
        return write_dataset(
            folder,
            world=self.config.world,
            images=np.concatenate([scene["images"] for scene in scenes]),
            free=[part for scene in scenes for part in scene["free"]],
            collision=collision if self.config.collision_per_scenario else None,
            scenes={name: np.concatenate([scene[name] for scene in scenes]) for name in known},
            extra_images=np.concatenate([extra["images"] for extra in extras]) if extras else None,
            generator=self.config.model_dump(mode="json"),
        )


def draw_configurations(
    checker: Checker, count: int, rng: np.random.Generator, *, free: bool
) -> NDArray[np.float64]:
    """``count`` uniform configurations that are free (or in collision), (count, d) rad.

    Raises:
        DatasetError: hardly any configuration is.
    """
    space = checker.space
    found: list[NDArray[np.float64]] = [np.empty((0, space.dim))]
    have = proposed = 0
    while have < count:
        if proposed > MAX_PROPOSALS_PER_SAMPLE * count:
            raise DatasetError(
                f"hardly any configuration is {'free' if free else 'in collision'}",
                expected=f"{count} among {proposed}",
                got=str(have),
                remedy="change the robot or ask for fewer",
            )
        proposals = space.sample_uniform(rng, max(_MIN_ROUND, 2 * (count - have)))
        kept = proposals[checker.valid_batch(proposals) == free]
        found.append(kept)
        have += len(kept)
        proposed += len(proposals)
    return np.concatenate(found)[:count]
