"""Import of somebody's own data: a folder of pictures with their configurations as arrays.

pictures/
  kitchen.png             a scenario
  kitchen.npy             (n, d) rad: configurations that are free in it
  kitchen.collision.npy   (m, d) rad: configurations in collision; optional
  extra/*.png             pictures without configurations; optional

For depth cameras a scenario is kitchen.json, which names its PNGs and tells their cameras
(:mod:`training.datasets.own_pictures`).
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, require_room, write_dataset
from cspace.errors import DatasetError
from cspace.npy import map_npy
from cspace.space import JointSpace
from cspace.world import World
from training.datasets.own_pictures import found_pictures, read_own_picture

EXTRA_FOLDER = "extra"
COLLISION_ENDING = ".collision.npy"


@dataclass(frozen=True, slots=True)
class OwnScenario:
    """One picture with its configurations.

    Args:
        image: (P, P, 3) uint8.
        free: (n, d) rad.
        collision: (m, d) rad; no rows where there is no file.
    """

    image: NDArray[np.uint8]
    free: NDArray[np.float64]
    collision: NDArray[np.float64]


def import_folder(source: Path, folder: Path, *, world: World) -> Dataset:
    """Write the data set of a folder of pictures, scenarios in the order of their names.

    Args:
        source: pictures and arrays as above; any size from 16 to 2048 pixels, resized to the camera's.
        folder: the data set's, must not exist.
        world: robot and sensor.

    Raises:
        DatasetError: a file is missing or does not fit; it is named.
        StorageError: the folder exists or cannot be written.
    """
    pictures = found_pictures(source)
    if not pictures:
        raise DatasetError(
            f"{source} holds no pictures",
            expected="scenario.png with scenario.npy",
            got="no *.png, no *.json",
        )
    _refuse_strays(source, pictures)
    require_room(folder, 2 * sum(path.stat().st_size for path in source.glob("*.npy")))
    scenarios = [_read(picture, world) for picture in pictures]
    extras = [read_own_picture(path, world) for path in found_pictures(source / EXTRA_FOLDER)]
    has_collision = any(len(scenario.collision) for scenario in scenarios)
    return write_dataset(
        folder,
        # Where the pictures come from, nobody says.
        world=replace(cast("Any", world), scenes=None),
        images=np.stack([scenario.image for scenario in scenarios]),
        free=[scenario.free for scenario in scenarios],
        collision=[scenario.collision for scenario in scenarios] if has_collision else None,
        extra_images=np.stack(extras) if extras else None,
        generator={"imported": [picture.name for picture in pictures]},
    )


def _read(picture: Path, world: World) -> OwnScenario:
    free = _configurations(picture.with_suffix(".npy"), world.space)
    path = picture.with_suffix(COLLISION_ENDING)
    collision = _configurations(path, world.space) if path.exists() else np.empty((0, world.dim))
    return OwnScenario(read_own_picture(picture, world), free, collision)


def _configurations(path: Path, space: JointSpace) -> NDArray[np.float64]:
    dim = space.dim
    if not path.is_file():
        raise DatasetError(
            f"{path} is missing",
            expected="free configurations of the picture beside it",
            remedy=f"add it, or move the picture to {EXTRA_FOLDER}/",
        )
    array = map_npy(path, DatasetError)
    if array.ndim != 2 or array.shape[1] != dim or array.dtype.kind not in "fiu":
        raise DatasetError(
            f"{path} does not fit the robot",
            expected=f"numbers of shape (n, {dim})",
            got=f"{array.dtype} of shape {array.shape}",
        )
    if not np.isfinite(array).all():
        raise DatasetError(f"{path} holds values that are not finite", expected="angles in rad")
    return space.admitted(array, f"{path} holds configurations outside the robot's limits", DatasetError)


def _refuse_strays(source: Path, pictures: list[Path]) -> None:
    """An array without its picture is a mistake in a name, and its data would be lost without a word."""
    known = {
        picture.with_suffix(ending).name for picture in pictures for ending in (".npy", COLLISION_ENDING)
    }
    strays = sorted(path.name for path in source.glob("*.npy") if path.name not in known)
    if strays:
        raise DatasetError(
            f"{source / strays[0]} belongs to no picture", expected="a picture of the same name", got="none"
        )
