"""Data sets of what became of plans, from the outcomes that a tracking server holds."""

import base64
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, write_dataset
from cspace.errors import DatasetError
from cspace.planning.paths import length_rad, spread_points
from cspace.space import JointSpace
from cspace.world import World
from cspace.worlds import robot_digest
from services.names import VIEWS_FILE
from services.outcomes import run_files, uploaded
from services.registry.tracking import Tracking
from training.data.own_data import read_picture

# One picture in so many is held out. A path's points are so far apart, and each so many of them is a row.
HELD_OUT, _FINE_RAD, _EVERY = 5, 0.02, 5

Labelled = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlan:
    """A plan of which pictures were kept and the end is known.

    ``image`` is what showed the scene, as it was sent; ``path`` (k, d) rad; ``collided_at`` where it collides
    first, as a share of its length, None where it is free; ``run_id`` of the batch that holds the pictures.
    """

    image: bytes
    path: NDArray[np.float64]
    collided_at: float | None
    run_id: str

    @property
    def picture(self) -> str:
        """SHA-256 of the image."""
        return hashlib.sha256(self.image).hexdigest()

    @property
    def held_out(self) -> bool:
        """Whether it is left out of training, as a fifth of all pictures is."""
        return int(self.picture, 16) % HELD_OUT == 0

    def labelled(self, space: JointSpace) -> Labelled:
        """Configurations of the path that are known to be free, and to collide, each (n, d) rad.

        What comes after a collision is not known, nor for certain the tenth of a radian before it.
        """
        count = max(2, int(np.ceil(length_rad(self.path, space) / _FINE_RAD)) + 1)
        rows = space.to_float32(spread_points(self.path, count, space))
        if self.collided_at is None:
            return rows[::_EVERY], rows[:0]
        hit = round(self.collided_at * (count - 1))
        return rows[: max(0, hit - _EVERY) : _EVERY], rows[hit : hit + 1]


def known_plans(tracking: Tracking, robot: str, site: str | None = None) -> Iterator[KnownPlan]:
    """All plans of a robot of which pictures were kept and the end was reported, the oldest batch first.

    ``robot`` is its SHA-256, as answers name it; ``site`` is one place, None for all.
    """
    ends: dict[tuple[Any, Any], float | None] = {}
    for _, _, reported in uploaded(tracking):
        for one in reported:
            if one.kind != "plan" or site not in (None, one.site):
                continue
            key = one.client, one.request_id
            # Who reports a success without more has seen no collision.
            if one.collided is False or (one.collided is None and one.success):
                ends[key] = None
            elif one.collided_at is not None:
                ends[key] = one.collided_at
            else:
                ends.pop(key, None)
    for run_id, views in run_files(tracking, VIEWS_FILE):
        for row in map(json.loads, views.read_bytes().splitlines()):
            key = row.get("client"), row["request_id"]
            if key in ends and row["robot"] == robot:
                path = np.array(row["path"], dtype=np.float64)
                yield KnownPlan(base64.b64decode(row["image"]), path, ends.pop(key), run_id)


def import_outcomes(folder: Path, *, world: World, tracking: Tracking, site: str | None = None) -> Dataset:
    """Write the data set of a robot's plans that were kept: a scenario for each picture.

    Free are configurations along paths up to where they collide, in collision those where they do.
    A fifth of the pictures is left to evaluations.
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
    free, collision = (
        [np.concatenate([one[side] for one in plans]) for plans in found.values()] for side in (0, 1)
    )
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
