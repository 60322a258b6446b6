"""Import of own data: a folder of pictures, or of views in JSON, with their configurations as arrays."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from cspace.dataset import Dataset, require_room, write_dataset
from cspace.errors import DatasetError, ImageError
from cspace.files import LEFT_OUT, map_npy, parse_json, read_bounded, read_object, validated
from cspace.space import JointSpace
from cspace.view_file import MAX_PICTURES, pack_view
from cspace.world import World

_MAX_BYTES = 8 * 2**20
_KINDS = (".png", ".tif", ".tiff", ".npy")
EXTRA_FOLDER = "extra"
COLLISION_ENDING = ".collision.npy"


def _is_name(name: str) -> str:
    if not name.endswith(_KINDS) or Path(name).name != name:
        raise ValueError(f"the name of a file beside it, {', '.join(_KINDS)}")
    return name


@validated(DatasetError)
class View:
    """A JSON file that names its pictures."""

    pictures: Annotated[
        tuple[Annotated[str, AfterValidator(_is_name)], ...], Field(min_length=1, max_length=MAX_PICTURES)
    ]
    cameras: list[object]
    state: Annotated[object, LEFT_OUT] = None
    depth_scale_m: Annotated[object, LEFT_OUT] = None


def _read_view(path: Path) -> View:
    data = read_bounded(path, _MAX_BYTES, DatasetError)
    try:
        values = parse_json(data)
    except ValueError as error:
        raise DatasetError(f"{path} is no JSON", got=str(error)[:200]) from error
    return read_object(View, values, str(path), DatasetError)


def _found_pictures(folder: Path) -> dict[Path, View | None]:
    """The files of a folder that show a scene each, by their names: views, view files and other PNGs."""
    views = {path: _read_view(path) for path in folder.glob("*.json")}
    named = {name for view in views.values() for name in view.pictures}
    others = [path for path in folder.glob("*.png") if path.name not in named]
    return {path: views.get(path) for path in sorted([*views, *folder.glob("*.view"), *others])}


def _read_picture_of(path: Path, view: View | None, world: World) -> NDArray[np.uint8]:
    if view is None:
        return read_picture(read_bounded(path, _MAX_BYTES, DatasetError), str(path), world)
    files = [read_bounded(path.with_name(name), _MAX_BYTES, DatasetError) for name in view.pictures]
    try:
        data = pack_view(files, view.cameras, view.state, view.depth_scale_m)
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


def import_folder(source: Path, folder: Path, *, world: World) -> Dataset:
    """Write the data set of a folder of pictures, scenarios in the order of their names.

    Pictures have 16 to 2048 pixels and are resized to the camera's.
    """
    pictures = _found_pictures(source)
    if not pictures:
        raise DatasetError(
            f"{source} holds no pictures",
            expected="scenario.png with scenario.npy",
            got="no *.png, no *.json",
        )
    _refuse_strays(source, pictures)
    require_room(folder, 2 * sum(path.stat().st_size for path in source.glob("*.npy")))
    free = [_configurations(path.with_suffix(".npy"), world.space) for path in pictures]
    none = np.empty((0, world.dim))
    beside = [path.with_suffix(COLLISION_ENDING) for path in pictures]
    collision = [_configurations(path, world.space) if path.exists() else none for path in beside]
    extras = _found_pictures(source / EXTRA_FOLDER)
    return write_dataset(
        folder,
        # Where the pictures come from, nobody says.
        world=replace(cast("Any", world), scenes=None),
        images=np.stack([_read_picture_of(path, view, world) for path, view in pictures.items()]),
        free=free,
        collision=collision if any(map(len, collision)) else None,
        extra_images=np.stack([_read_picture_of(path, view, world) for path, view in extras.items()])
        if extras
        else None,
        generator={"imported": [path.name for path in pictures]},
    )


def _configurations(path: Path, space: JointSpace) -> NDArray[np.float64]:
    if not path.is_file():
        raise DatasetError(
            f"{path} is missing",
            expected="free configurations of the picture beside it",
            remedy=f"add it, or move the picture to {EXTRA_FOLDER}/",
        )
    array = map_npy(path, DatasetError)
    if array.ndim != 2 or array.shape[1] != space.dim or array.dtype.kind not in "fiu":
        raise DatasetError(
            f"{path} does not fit the robot",
            expected=f"numbers of shape (n, {space.dim})",
            got=f"{array.dtype} of shape {array.shape}",
        )
    if not np.isfinite(array).all():
        raise DatasetError(f"{path} holds values that are not finite", expected="angles in rad")
    # Row after row, as the digest takes it.
    rows = np.ascontiguousarray(array)
    return space.admitted(rows, f"{path} holds configurations outside the robot's limits", DatasetError)


def _refuse_strays(source: Path, pictures: dict[Path, View | None]) -> None:
    """An array without its picture is a mistake in a name, and its data would be lost without a word."""
    known = {path.with_suffix(ending).name for path in pictures for ending in (".npy", COLLISION_ENDING)}
    known |= {name for view in pictures.values() if view is not None for name in view.pictures}
    strays = sorted(path.name for path in source.glob("*.npy") if path.name not in known)
    if strays:
        raise DatasetError(
            f"{source / strays[0]} belongs to no picture", expected="a picture of the same name", got="none"
        )
