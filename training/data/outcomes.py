"""Data sets of what became of plans, from the outcomes that a tracking server holds."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, write_dataset
from cspace.errors import DatasetError
from cspace.world import World
from cspace.worlds import robot_digest
from services.outcomes import known_plans
from services.registry.ports import Tracking
from training.data.own import read_picture

Labelled = tuple[NDArray[np.float32], NDArray[np.float32]]


def import_outcomes(folder: Path, *, world: World, tracking: Tracking, site: str | None = None) -> Dataset:
    """Write the data set of a robot's plans that were kept: a scenario for each picture.

    Free are configurations along paths up to where they collide, in collision those where they do.
    A fifth of the pictures is left to evaluations.

    Args:
        folder: the data set's, must not exist.
        world: robot and sensor.
        tracking: where outcomes were uploaded.
        site: plans of one place; None for all.

    Raises:
        DatasetError: no such plan is known, or a picture is none of the world's sensor.
        RegistryError: the tracking server is away or refuses.
        StorageError: the folder exists or cannot be written.
    """
    images: dict[str, bytes] = {}
    found: dict[str, list[Labelled]] = {}
    batches: dict[str, int] = {}
    for plan in known_plans(tracking, robot_digest(world), site):
        labelled = plan.labelled(world.space)
        if not plan.held_out and any(map(len, labelled)):
            images[plan.picture] = plan.image
            found.setdefault(plan.picture, []).append(labelled)
            batches[plan.run_id] = batches.get(plan.run_id, 0) + 1
    if not images:
        raise DatasetError(
            "there are no plans to train on",
            expected="plans that were kept, and whose outcomes were uploaded",
            got=f"none of robot {robot_digest(world)[:8]}" + ("" if site is None else f" at {site}"),
            remedy="plan with keep, report with POST /outcomes, upload with python -m services.outcomes",
        )
    free, collision = ([np.concatenate(one) for one in side] for side in _sides(found))
    return write_dataset(
        folder,
        # Where the pictures come from, nobody says.
        world=replace(cast("Any", world), scenes=None),
        images=np.stack(
            [read_picture(image, f"the kept picture {name[:12]}", world) for name, image in images.items()]
        ),
        free=free,
        collision=collision,
        generator={"outcomes": batches, "site": site, "split": "train"},
    )


def _sides(found: dict[str, list[Labelled]]) -> tuple[list[list[NDArray[np.float32]]], ...]:
    return tuple([[one[side] for one in plans] for plans in found.values()] for side in (0, 1))
