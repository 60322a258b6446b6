"""Pictures that somebody brings: a PNG, or a view in JSON that names PNGs of one scene with their cameras.

    {"pictures": ["left.png", "right.png"], "cameras": [{"fx": ..., "pose": ...}, ...], "state": [0.0, ...]}

``state``, rad, is where the robot was; null or absent where it is in no picture. ``depth_scale_m`` is how
many metres one unit of the pictures stands for; null or absent for mm.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import DatasetError, ImageError
from cspace.files import read_bounded
from cspace.strict_json import parse_json, read_members
from cspace.view_file import MAX_PICTURES, pack_view
from cspace.world import World

_MAX_BYTES = 8 * 2**20
_KEYS = {"pictures", "cameras", "state", "depth_scale_m"}


def found_pictures(folder: Path) -> list[Path]:
    """The files of a folder that show a scene each, in the order of their names: views, and other PNGs.

    Raises:
        DatasetError: a view is none.
    """
    views = sorted(folder.glob("*.json"))
    named = {name for view in views for name in _told(view)["pictures"]}
    return sorted([*views, *(path for path in folder.glob("*.png") if path.name not in named)])


def read_own_picture(path: Path, world: World) -> NDArray[np.uint8]:
    """The picture of a scene as its world reads it.

    Raises:
        DatasetError: a file is missing, too large, or not what the world takes; it is named.
    """
    try:
        return world.read_picture(_view(path) if path.suffix == ".json" else _bytes(path))
    except ImageError as error:
        raise DatasetError(
            f"{path}: {error.what}", expected=error.expected, got=error.got, remedy=error.remedy
        ) from error


def _view(path: Path) -> bytes:
    told = _told(path)
    files = [_bytes(path.with_name(name)) for name in told["pictures"]]
    cameras = told["cameras"] if isinstance(told["cameras"], list) else []
    return pack_view(files, cameras, told["state"], told["depth_scale_m"])


def _told(path: Path) -> dict[str, Any]:
    data = _bytes(path)
    try:
        values = parse_json(data)
    except ValueError as error:
        raise DatasetError(f"{path} is no JSON", got=str(error)[:200]) from error
    told = {"state": None, "depth_scale_m": None, **values} if isinstance(values, dict) else values
    members = read_members(told, _KEYS, str(path), DatasetError)
    names = members["pictures"]
    if not isinstance(names, list) or not 1 <= len(names) <= MAX_PICTURES or not all(map(_is_name, names)):
        raise DatasetError(
            f"{path} names no pictures",
            expected=f"1 to {MAX_PICTURES} names of PNG files beside it",
            got=repr(names)[:200],
        )
    return members


def _is_name(name: object) -> bool:
    return isinstance(name, str) and name.endswith(".png") and Path(name).name == name


def _bytes(path: Path) -> bytes:
    return read_bounded(path, _MAX_BYTES, DatasetError)
