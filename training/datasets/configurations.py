"""Data sets of free and colliding configurations, as a recipe."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, write_dataset
from cspace.worlds.planar.scene import Camera
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
        pictures = (config.scenario_count + config.extra_image_count) * Camera().pixels ** 2 * 3
        rows = config.scenario_count * (config.free_per_scenario + config.collision_per_scenario)
        return pictures + rows * 8 * len(config.robot.link_lengths_m)

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
        collision = [part for scene in scenes for part in scene["collision"]]
        return write_dataset(
            folder,
            robot=self.config.robot_value(),
            camera=Camera(),
            images=np.concatenate([scene["images"] for scene in scenes]),
            free=[part for scene in scenes for part in scene["free"]],
            collision=collision if self.config.collision_per_scenario else None,
            discs=np.concatenate([scene["discs"] for scene in scenes]),
            extra_images=np.concatenate([extra["images"] for extra in extras]) if extras else None,
            generator=self.config.model_dump(mode="json"),
        )
