"""Data sets as recipes, and that of free and colliding configurations."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
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


class Recipe(ABC):
    """How the shards of a data set are made, anywhere, and put together."""

    def __init__(self, config: Any, values_per_scenario: int, extra_image_count: int = 0) -> None:
        self.config, self.values_per_scenario = config, values_per_scenario
        self.extra_image_count = extra_image_count

    @abstractmethod
    def row(self, index: int, extra: bool) -> dict[str, NDArray[Any]]:
        """The arrays of one scenario, or of one picture alone."""

    @property
    def finished_bytes(self) -> int:
        """Of pictures, configurations and paths."""
        count = self.config.scenario_count
        pictures = (count + self.extra_image_count) * math.prod(self.config.world.sensor.picture_shape)
        return int(pictures + 8 * count * self.values_per_scenario)

    def plan(self) -> list[Shard]:
        """Scenarios, then pictures alone."""
        size = self.config.shard_size
        return [
            Shard(first, min(size, total - first), extra)
            for extra, total in ((False, self.config.scenario_count), (True, self.extra_image_count))
            for first in range(0, total, size)
        ]

    def make(self, shard: Shard) -> dict[str, NDArray[Any]]:
        """The arrays of one shard; the same whatever the shards' size and wherever it is computed."""
        offset = EXTRA_FIRST_INDEX if shard.extra else 0
        rows = [self.row(offset + shard.first + place, shard.extra) for place in range(shard.count)]
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}

    def write(self, folder: Path, load: Callable[[Shard], Arrays]) -> Dataset:
        """The data set of all shards."""
        world, kept = self.config.world, dict[str, list[NDArray[Any]]]()
        # Filled shard by shard: arrays of space are large, and are not held twice.
        shape = world.sensor.picture_shape
        images = np.empty((self.config.scenario_count, *shape), dtype=np.uint8)
        extras = np.empty((self.extra_image_count, *shape), dtype=np.uint8)
        for shard in self.plan():
            arrays = dict(load(shard))
            (extras if shard.extra else images)[shard.rows] = arrays.pop("images")
            if not shard.extra:
                for name, rows in (_split(arrays) if "labelled" in arrays else arrays).items():
                    kept.setdefault(name, []).extend(rows)
        paths = [(scenario, path) for scenario, rows in enumerate(kept.get("paths", ())) for path in rows]
        return write_dataset(
            folder,
            world=world,
            images=images,
            free=kept["free"],
            collision=kept.get("collision"),
            attributes={name: kept[name] for name in ATTRIBUTES if name in kept},
            paths=paths or None,
            scenes={name: np.stack(kept[name]) for name in world.scene_files},
            extra_images=extras if len(extras) else None,
            generator=self.config.model_dump(mode="json"),
        )


class ConfigurationRecipe(Recipe):
    """Data sets of free and colliding configurations."""

    config: DatasetConfig

    def __init__(self, config: DatasetConfig) -> None:
        rows = config.proposals_per_scenario or config.free_per_scenario + config.collision_per_scenario
        super().__init__(config, rows * config.world.dim, config.extra_image_count)

    def row(self, index: int, extra: bool) -> dict[str, NDArray[Any]]:
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
                sides = {"free": sample_configurations(checker, config.free_per_scenario, rng, free=True)}
                if count := config.collision_per_scenario:
                    sides["collision"] = sample_configurations(checker, count, rng, free=False)
            except DatasetError as error:
                problem = error
                continue
            return {
                "images": simulator.render(scene),
                **simulator.arrays_of(scene),
                **sides,
            }
        raise problem


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


def sample_configurations(
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
