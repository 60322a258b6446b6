"""One shard of a generated data set: a pure function of its configuration and its range of scenarios."""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import DatasetError
from cspace.files import replacing
from cspace.splits import Split, scenario_rng
from cspace.workshop import Checker
from cspace.worlds import workshop_of
from training.datasets.config import DatasetConfig

# Pictures alone come from the same split under indices that no scenario with configurations has.
EXTRA_FIRST_INDEX = 2**31
# Rejection gives up on a scenario whose free (or colliding) share is smaller than one in this many.
MAX_PROPOSALS_PER_SAMPLE = 1000
_MIN_ROUND = 64


@dataclass(frozen=True, slots=True)
class Shard:
    """A range of scenarios, or of pictures alone.

    Args:
        first: index of the first.
        count: how many.
        extra: pictures alone.
    """

    first: int
    count: int
    extra: bool

    @property
    def file_name(self) -> str:
        """The shard's file within the unfinished data set."""
        return f"{'extra' if self.extra else 'scenes'}-{self.first:08d}-{self.count}.npz"


def plan_shards(config: DatasetConfig) -> list[Shard]:
    """All shards of a data set, in order."""
    return [
        Shard(first, min(config.shard_size, total - first), extra)
        for extra, total in ((False, config.scenario_count), (True, config.extra_image_count))
        for first in range(0, total, config.shard_size)
    ]


def make_shard(config: DatasetConfig, shard: Shard) -> dict[str, NDArray[Any]]:
    """The arrays of one shard; the same whatever the shards' size and wherever it is computed."""
    workshop, split = workshop_of(config.world), Split(config.split)
    offset = EXTRA_FIRST_INDEX if shard.extra else 0
    images, free, collision, geometry = [], [], [], []
    for index in range(shard.first, shard.first + shard.count):
        rng = scenario_rng(split, config.seed, offset + index)
        scene = workshop.scene(rng)
        images.append(workshop.render(scene))
        if shard.extra:
            continue
        geometry.append(workshop.arrays_of(scene))
        checker = workshop.checker(scene)
        free.append(draw_configurations(checker, config.free_per_scenario, rng, free=True))
        collision.append(draw_configurations(checker, config.collision_per_scenario, rng, free=False))
    arrays = {"images": np.stack(images)}
    if not shard.extra:
        arrays |= {name: np.stack([one[name] for one in geometry]) for name in config.world.scene_files}
        arrays |= {"free": np.stack(free), "collision": np.stack(collision)}
    return arrays


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


def save_shard(folder: Path, shard: Shard, arrays: dict[str, NDArray[Any]]) -> Path:
    """Write a shard beside its place and rename it.

    Raises:
        StorageError: the folder cannot be written.
    """
    path = folder / shard.file_name
    with replacing(path, str(path)) as beside, beside.open("wb") as handle:
        np.savez(handle, **arrays)  # type: ignore[arg-type]
    return path


def load_shard(folder: Path, shard: Shard) -> dict[str, NDArray[Any]] | None:
    """A shard that an earlier attempt finished, or None when there is none that can be read whole."""
    try:
        # Opened here, as numpy leaves a file open that is no archive.
        with (folder / shard.file_name).open("rb") as handle, np.load(handle, allow_pickle=False) as arrays:
            # Reading compares each array with its checksum.
            return {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
