"""Data sets of free and colliding configurations, as a recipe."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, write_dataset
from training.datasets.config import DatasetConfig
from training.datasets.recipe import Arrays
from training.datasets.shards import Shard, make_shard, plan_shards


@dataclass(frozen=True)
class ConfigurationRecipe:
    """See :class:`training.datasets.recipe.Recipe`."""

    config: DatasetConfig

    @property
    def key(self) -> str:
        """Of the configuration."""
        return self.config.key

    @property
    def finished_bytes(self) -> int:
        """Of pictures and configurations."""
        config = self.config
        pictures = config.scenario_count + config.extra_image_count
        rows = config.scenario_count * (config.free_per_scenario + config.collision_per_scenario)
        return pictures * math.prod(config.world.sensor.picture_shape) + rows * 8 * config.world.dim

    def plan(self) -> list[Shard]:
        """Scenarios, then pictures alone."""
        return plan_shards(self.config)

    def make(self, shard: Shard) -> dict[str, NDArray[Any]]:
        """See :func:`training.datasets.shards.make_shard`."""
        return make_shard(self.config, shard)

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
