"""Import of own data: a folder of pictures, or of views in JSON, with their configurations as arrays."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from cspace.dataset import Dataset, require_room, write_dataset
from cspace.errors import DatasetError, ImageError
from cspace.files import map_npy, read_bounded
from cspace.space import JointSpace
from cspace.strict_json import LEFT_OUT, parse_json, read_object, validated
from cspace.view_file import MAX_PICTURES, pack_view
from cspace.world import World

_MAX_BYTES = 8 * 2**20
_KINDS = (".png", ".tif", ".tiff", ".npy")


def found_pictures(folder: Path) -> list[Path]:
    """The files of a folder that show a scene each, in the order of their names: views, and other PNGs.

    A view is a JSON file that names its pictures, or a view file (``.view``).
    """
    views = sorted(folder.glob("*.json"))
    named = {name for view in views for name in _read_view(view).pictures}
    others = (path for path in folder.glob("*.png") if path.name not in named)
    return sorted([*views, *folder.glob("*.view"), *others])


def read_own_picture(path: Path, world: World) -> NDArray[np.uint8]:
    """The picture of a scene as its world reads it."""
    # A view may be none as well.
    try:
        data = _view(path) if path.suffix == ".json" else _bytes(path)
    except ImageError as error:
        raise _named(str(path), error) from error
    return read_picture(data, str(path), world)


def read_picture(data: bytes, where: str, world: World) -> NDArray[np.uint8]:
    """The picture in a file's bytes as its world reads it; raises DatasetError with the file's name."""
    try:
        return world.read_picture(data)
    except ImageError as error:
        raise _named(where, error) from error


def _named(where: str, error: ImageError) -> DatasetError:
    what = f"{where}: {error.what}"
    return DatasetError(what, expected=error.expected, got=error.got, remedy=error.remedy)


def _view(path: Path) -> bytes:
    view = _read_view(path)
    files = [_bytes(path.with_name(name)) for name in view.pictures]
    return pack_view(files, view.cameras, view.state, view.depth_scale_m)


def _is_name(name: str) -> str:
    if not name.endswith(_KINDS) or Path(name).name != name:
        raise ValueError(f"the name of a file beside it, {', '.join(_KINDS)}")
    return name


@validated(DatasetError)
class _View:
    pictures: Annotated[
        tuple[Annotated[str, AfterValidator(_is_name)], ...], Field(min_length=1, max_length=MAX_PICTURES)
    ]
    cameras: list[object]
    state: Annotated[object, LEFT_OUT] = None
    depth_scale_m: Annotated[object, LEFT_OUT] = None


def _read_view(path: Path) -> _View:
    data = _bytes(path)
    try:
        values = parse_json(data)
    except ValueError as error:
        raise DatasetError(f"{path} is no JSON", got=str(error)[:200]) from error
    return read_object(_View, values, str(path), DatasetError)


def _bytes(path: Path) -> bytes:
    return read_bounded(path, _MAX_BYTES, DatasetError)


EXTRA_FOLDER = "extra"
COLLISION_ENDING = ".collision.npy"


@dataclass(frozen=True, slots=True)
class OwnScenario:
    """One picture (P, P, 3) uint8 with its configurations (n, d) and (m, d) rad."""

    image: NDArray[np.uint8]
    free: NDArray[np.float64]
    collision: NDArray[np.float64]


def import_folder(source: Path, folder: Path, *, world: World) -> Dataset:
    """Write the data set of a folder of pictures, scenarios in the order of their names.

    Pictures have 16 to 2048 pixels and are resized to the camera's.
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
    if both := {row.tobytes() for row in world.space.to_float32(free)} & {
        row.tobytes() for row in world.space.to_float32(collision)
    }:
        raise DatasetError(
            f"{path} holds configurations that {picture.stem}.npy holds too",
            expected="each of them free or in collision",
            got=f"{len(both)} in both",
            remedy="leave them out of one of the files",
        )
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
    # Row after row, as the digest takes it.
    rows = np.ascontiguousarray(array)
    return space.admitted(rows, f"{path} holds configurations outside the robot's limits", DatasetError)


def _refuse_strays(source: Path, pictures: list[Path]) -> None:
    """An array without its picture is a mistake in a name, and its data would be lost without a word."""
    known = {
        picture.with_suffix(ending).name for picture in pictures for ending in (".npy", COLLISION_ENDING)
    }
    known |= {name for one in pictures if one.suffix == ".json" for name in _read_view(one).pictures}
    strays = sorted(path.name for path in source.glob("*.npy") if path.name not in known)
    if strays:
        raise DatasetError(
            f"{source / strays[0]} belongs to no picture", expected="a picture of the same name", got="none"
        )
