"""Generation of a data set by Ray tasks: shards in parallel, resumable, assembled at the end."""

import logging
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import ray
from numpy.typing import NDArray
from pydantic import ValidationError
from ray.exceptions import RayError, RayTaskError

from cspace.dataset import Dataset, open_dataset, require_room, write_dataset
from cspace.errors import CspaceError, DatasetError, JobError, StorageError
from cspace.scenario import Camera
from training.datasets.config import DatasetConfig
from training.datasets.progress import Progress
from training.datasets.shards import Shard, load_shard, make_shard, plan_shards, save_shard

_LOG = logging.getLogger("training")


def generate(config: DatasetConfig, folder: Path) -> Dataset:
    """The data set of ``config`` at ``folder``: opened when it is there, finished or made otherwise.

    An interrupted generation leaves its finished shards beside the folder and goes on from them; shards of
    another configuration are never taken.

    Raises:
        DamagedFileError: the data set that is there is damaged.
        DatasetError: another data set is there.
        JobError: a task failed for good.
        StorageError: the disk is too full or cannot be written.
    """
    if folder.exists():
        return _reuse(config, folder)
    require_room(folder, _estimated_bytes(config))
    partial = folder.with_name(f"{folder.name}.{config.key}.partial")
    try:
        partial.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            "the data folder cannot be written", expected=str(partial), got=str(error)
        ) from error
    shards = plan_shards(config)
    missing = [shard for shard in shards if load_shard(partial, shard) is None]
    with Progress("data", len(missing)) as progress:
        for _ in run_tasks(config, missing, partial):
            progress.advance()
    dataset = _assemble(config, folder, partial, shards)
    shutil.rmtree(partial, ignore_errors=True)
    return dataset


def _reuse(config: DatasetConfig, folder: Path) -> Dataset:
    dataset = open_dataset(folder)
    try:
        there = DatasetConfig.model_validate(dict(dataset.manifest.generator)).key
    except ValidationError:
        there = "somebody's own data"
    if there != config.key:
        raise DatasetError(
            f"{folder} holds another data set",
            expected=f"the configuration {config.key}",
            got=there,
            remedy="name another folder, or remove this one",
        )
    _LOG.info("data: reusing %s", folder)
    return dataset


def run_tasks(config: DatasetConfig, shards: Iterable[Shard], partial: Path) -> Iterator[str]:
    """Make shards in parallel on the cluster; yields each one's file as it is finished.

    Raises:
        CspaceError: what a task raised; JobError when its process died again and again.
    """
    task = ray.remote(num_cpus=1, max_retries=2)(_task)
    waiting = [task.remote(config.model_dump(mode="json"), shard, str(partial)) for shard in shards]
    try:
        while waiting:
            finished, waiting = ray.wait(waiting, num_returns=1)
            yield from ray.get(finished)
    except RayError as error:
        if isinstance(error, RayTaskError) and isinstance(error.cause, CspaceError):
            raise error.cause from error
        raise JobError("a task of the data set failed", got=str(error), remedy="run it again") from error
    finally:
        for reference in waiting:
            ray.cancel(reference)


def _task(config: dict[str, Any], shard: Shard, partial: str) -> str:
    values = DatasetConfig.model_validate(config)
    return str(save_shard(Path(partial), shard, make_shard(values, shard)))


def _assemble(config: DatasetConfig, folder: Path, partial: Path, shards: list[Shard]) -> Dataset:
    scenes, extras = ([_must_load(partial, s) for s in shards if s.extra is extra] for extra in (False, True))
    collision = [part for scene in scenes for part in scene["collision"]]
    return write_dataset(
        folder,
        robot=config.robot_value(),
        camera=Camera(),
        images=np.concatenate([scene["images"] for scene in scenes]),
        free=[part for scene in scenes for part in scene["free"]],
        collision=collision if config.collision_per_scenario else None,
        discs=np.concatenate([scene["discs"] for scene in scenes]),
        extra_images=np.concatenate([extra["images"] for extra in extras]) if extras else None,
        generator=config.model_dump(mode="json"),
    )


def _must_load(partial: Path, shard: Shard) -> dict[str, NDArray[Any]]:
    arrays = load_shard(partial, shard)
    if arrays is None:
        raise StorageError(
            f"{partial / shard.file_name} cannot be read back",
            expected="the shard that a task wrote",
            remedy="put the data folder where every node of the cluster can read and write it",
        )
    return arrays


def _estimated_bytes(config: DatasetConfig) -> int:
    """Twice the finished size: the shards are there until the arrays are written."""
    pictures = (config.scenario_count + config.extra_image_count) * Camera().pixels ** 2 * 3
    rows = config.scenario_count * (config.free_per_scenario + config.collision_per_scenario)
    return 2 * (pictures + rows * 8 * len(config.robot.link_lengths_m))
