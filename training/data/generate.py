"""Generation of a data set by Ray tasks: shards in parallel, resumable, assembled at the end."""

import logging
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from cspace.dataset import Dataset, open_dataset, require_room
from cspace.errors import DatasetError, StorageError
from cspace.files import make_output_folder, replacing
from services.commands import Progress
from services.evaluator.cluster import spread
from training.data.config import DatasetConfig, PathDatasetConfig, Shard
from training.data.configurations import ConfigurationRecipe
from training.data.paths import PathRecipe

_LOG = logging.getLogger("training")

Generated = DatasetConfig | PathDatasetConfig


def recipe_of(config: Generated) -> ConfigurationRecipe | PathRecipe:
    """How the data set of a configuration is made."""
    return PathRecipe(config) if isinstance(config, PathDatasetConfig) else ConfigurationRecipe(config)


def generate(config: Generated, folder: Path) -> Dataset:
    """The data set of ``config`` at ``folder``: opened when it is there, finished or made otherwise.

    An interrupted generation leaves its finished shards beside the folder and goes on from them; shards of
    another configuration are never taken.
    """
    if folder.exists():
        return _reuse(config, folder)
    recipe = recipe_of(config)
    # Twice the finished size: the shards are there until the arrays are written.
    require_room(folder, 2 * recipe.finished_bytes)
    size = recipe.finished_bytes / 2**30
    _LOG.info("data: %.1f GiB at %s, and as much again until it is finished", size, folder)
    partial = folder.with_name(f"{folder.name}.{config.key}.partial")
    try:
        make_output_folder(partial)
    except OSError as error:
        raise StorageError(
            "the data folder cannot be written", expected=str(partial), got=str(error)
        ) from error
    missing = [shard for shard in recipe.plan() if load_shard(partial, shard) is None]
    with Progress("data", len(missing), _LOG.info, "shard") as progress:
        for _ in run_tasks(config, missing, partial):
            progress.advance()
    dataset = recipe.write(folder, lambda shard: _must_load(partial, shard))
    shutil.rmtree(partial, ignore_errors=True)
    return dataset


def _reuse(config: Generated, folder: Path) -> Dataset:
    dataset = open_dataset(folder)
    try:
        there = type(config).model_validate(dict(dataset.manifest.generator)).key
    except ValidationError:
        there = "data of another kind, or somebody's own"
    if there != config.key:
        raise DatasetError(
            f"{folder} holds another data set",
            expected=f"the configuration {config.key}",
            got=there,
            remedy="name another folder, or remove this one",
        )
    _LOG.info("data: reusing %s", folder)
    return dataset


def run_tasks(config: Generated, shards: Sequence[Shard], partial: Path) -> Iterator[str]:
    """Make shards in parallel on the cluster; yields each one's file as it is finished."""
    return spread(_task, shards, (config, str(partial)), "generation of the data set", "run it again")


def _task(shard: Shard, shared: tuple[Generated, str]) -> str:
    config, partial = shared
    return str(save_shard(Path(partial), shard, recipe_of(config).make(shard)))


def save_shard(folder: Path, shard: Shard, arrays: dict[str, NDArray[Any]]) -> Path:
    """Write a shard beside its place and rename it."""
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


def _must_load(partial: Path, shard: Shard) -> dict[str, NDArray[Any]]:
    arrays = load_shard(partial, shard)
    if arrays is None:
        raise StorageError(
            f"{partial / shard.file_name} cannot be read back",
            expected="the shard that a task wrote",
            remedy="put the data folder where every node of the cluster can read and write it",
        )
    return arrays
