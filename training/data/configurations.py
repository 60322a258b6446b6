"""Data sets of free and colliding configurations, as a recipe."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import ATTRIBUTES, Dataset, write_dataset
from cspace.errors import DatasetError
from cspace.simulator import Checker, Proposals, Split, scenario_rng
from cspace.world import Arrays
from cspace.worlds import simulator_of
from training.data.config import DatasetConfig, Shard

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
        each = config.proposals_per_scenario or config.free_per_scenario + config.collision_per_scenario
        rows = config.scenario_count * each
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
        simulator, rng = simulator_of(config.world), scenario_rng(split, config.seed, index)
        for _ in range(1 if simulator.count(split) else MAX_DRAWS):
            scene = simulator.scene(rng, split, index)
            if extra:
                return {"images": simulator.render(scene)}
            checker = simulator.checker(scene)
            if config.proposals_per_scenario:
                return {
                    "images": simulator.render(scene),
                    **simulator.arrays_of(scene),
                    **label(checker, simulator.proposals(scene, rng, config.proposals_per_scenario)),
                }
            try:
                free = plot_configurations(checker, config.free_per_scenario, rng, free=True)
                collision = plot_configurations(checker, config.collision_per_scenario, rng, free=False)
            except DatasetError as error:
                problem = error
                continue
            return {
                "images": simulator.render(scene),
                **simulator.arrays_of(scene),
                "free": free,
                "collision": collision,
            }
        raise problem

    def write(self, folder: Path, load: Callable[[Shard], Arrays]) -> Dataset:
        """The data set of all shards."""
        config = self.config
        known, kept = config.world.scene_files, dict[str, list[NDArray[Any]]]()
        # Filled shard by shard: arrays of space are large, and are not held twice.
        shape = config.world.sensor.picture_shape
        images = np.empty((config.scenario_count, *shape), dtype=np.uint8)
        extras = np.empty((config.extra_image_count, *shape), dtype=np.uint8)
        for shard in self.plan():
            arrays = dict(load(shard))
            (extras if shard.extra else images)[shard.rows] = arrays.pop("images")
            if not shard.extra:
                for name, rows in (_split(arrays) if "labelled" in arrays else arrays).items():
                    kept.setdefault(name, []).extend(rows)
        collided = config.collision_per_scenario or config.proposals_per_scenario
        return write_dataset(
            folder,
            world=config.world,
            images=images,
            free=kept["free"],
            collision=kept["collision"] if collided else None,
            attributes={name: kept[name] for name in ATTRIBUTES if name in kept},
            scenes={name: np.stack(kept[name]) for name in known},
            extra_images=extras if len(extras) else None,
            generator=config.model_dump(mode="json"),
        )


def label(checker: Checker, proposals: Proposals) -> dict[str, NDArray[Any]]:
    """``labelled`` (n, d) rad as they are stored, their ``clearance`` (n,) m and ``origin`` (n,)."""
    stored = checker.space.to_float32(proposals.configurations)
    clearance = checker.clearance(stored).astype(np.float32)
    return {"labelled": stored, "clearance": clearance, "origin": proposals.origins}


def _split(arrays: Arrays) -> dict[str, list[NDArray[Any]]]:
    """Arrays of scenarios, what is labelled in them told as free and in collision, each of its own length."""
    rows = ("labelled", "clearance", "origin")
    found = {name: list(array) for name, array in arrays.items() if name not in rows}
    sides = [clearance > 0.0 for clearance in arrays["clearance"]]
    for side, wanted in (("free", True), ("collision", False)):
        for name, key in zip(rows, (side, f"{side}_clearance", f"{side}_origin"), strict=True):
            found[key] = [one[free == wanted] for one, free in zip(arrays[name], sides, strict=True)]
    return found


def plot_configurations(
    checker: Checker, count: int, rng: np.random.Generator, *, free: bool
) -> NDArray[np.float64]:
    """``count`` uniform configurations that are free (or in collision), (count, d) rad."""
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
