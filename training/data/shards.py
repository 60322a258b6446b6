"""Shards of a generated data set: ranges of scenarios, and their files."""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.files import replacing
from cspace.world import World


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


class Pictures:
    """Pictures of a world, (count, ...) uint8, filled from the front."""

    def __init__(self, world: World, count: int) -> None:
        self.rows = np.empty((count, *world.sensor.picture_shape), dtype=np.uint8)
        self._filled = 0

    def add(self, images: NDArray[np.uint8]) -> None:
        """The next ones."""
        self.rows[self._filled : self._filled + len(images)] = images
        self._filled += len(images)


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
