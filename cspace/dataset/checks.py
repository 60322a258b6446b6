"""What the arrays of a data set must be; a bad one is an error that names its file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import DatasetError
from cspace.space import JointSpace, circles
from cspace.workshop import ORIGINS
from cspace.world import World

_BLOCK = 1_000_000
# Of each configuration, free or in collision: how far it is from contact, and how it was drawn.
TOLD: dict[str, type] = {
    f"{name}_{what}": dtype
    for name in ("free", "collision")
    for what, dtype in (("clearance", np.float32), ("origin", np.uint8))
}


def check_arrays(
    arrays: Mapping[str, NDArray[Any]],
    world: World,
    required: Sequence[str],
    optional: Sequence[str],
) -> None:
    """Check names, shapes, types, offsets and angles.

    Raises:
        DatasetError: something does not fit; says which file, what was expected and what came.
    """
    optional = (*optional, *world.scene_files)
    missing, unknown = set(required) - set(arrays), set(arrays) - set(required) - set(optional)
    if missing or unknown:
        raise DatasetError(
            "the data set's files do not fit",
            expected=f"{', '.join(required)} and optionally {', '.join(optional)}",
            got=f"without {sorted(missing)}, with {sorted(unknown)}",
        )
    picture = world.sensor.picture_shape
    scenarios = len(arrays["images"])
    _must("images.npy", arrays["images"], np.uint8, (None, *picture))
    if scenarios == 0:
        raise DatasetError("images.npy is empty", expected="at least one scenario", got="none")
    if "extra_images" in arrays:
        _must("extra_images.npy", arrays["extra_images"], np.uint8, (None, *picture))
    world.check_scenes(arrays, scenarios)
    _must_own("free", arrays, world.space, scenarios)
    if "collision" in arrays or "collision_offsets" in arrays:
        _must_own("collision", arrays, world.space, scenarios)
    for name in set(TOLD) & set(arrays):
        _must_tell(name, arrays)
    if {"paths", "path_offsets", "path_scenario"} & set(arrays):
        _must_hold_paths(arrays, world.space, scenarios)


def _must(file: str, array: NDArray[Any], dtype: type, shape: tuple[int | None, ...]) -> None:
    fits = array.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, array.shape, strict=True)
    )
    if array.dtype != dtype or not fits:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise DatasetError(
            f"{file} does not fit",
            expected=f"{np.dtype(dtype)} of shape ({wanted})",
            got=f"{array.dtype} of shape {array.shape}",
        )


def _must_own(name: str, arrays: Mapping[str, NDArray[Any]], space: JointSpace, scenarios: int) -> None:
    if name not in arrays or f"{name}_offsets" not in arrays:
        raise DatasetError(f"{name}.npy and {name}_offsets.npy belong together", got="only one of them")
    _must_be_angles(f"{name}.npy", arrays[name], space)
    _must_be_offsets(f"{name}_offsets.npy", arrays[f"{name}_offsets"], scenarios, len(arrays[name]))


def _must_tell(name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    rows, what = name.split("_")
    if rows not in arrays:
        raise DatasetError(f"{name}.npy belongs to {rows}.npy", got="the first alone")
    _must(f"{name}.npy", arrays[name], TOLD[name], (len(arrays[rows]),))
    values = arrays[name]
    fits = values < len(ORIGINS) if what == "origin" else (values > 0.0 if rows == "free" else values <= 0.0)
    if not fits.all():
        raise DatasetError(
            f"{name}.npy does not fit",
            expected=f"below {len(ORIGINS)}" if what == "origin" else "m, above 0 where free, else not",
            got=str(values[~fits][0]),
        )


def _must_hold_paths(arrays: Mapping[str, NDArray[Any]], space: JointSpace, scenarios: int) -> None:
    if not {"paths", "path_offsets", "path_scenario"} <= set(arrays):
        raise DatasetError(
            "paths.npy, path_offsets.npy and path_scenario.npy belong together", got="some of them"
        )
    _must_be_angles("paths.npy", arrays["paths"], space)
    owner = arrays["path_scenario"]
    _must("path_scenario.npy", owner, np.int64, (None,))
    _must_be_offsets("path_offsets.npy", arrays["path_offsets"], len(owner), len(arrays["paths"]))
    if len(owner) and not (owner.min() >= 0 and owner.max() < scenarios):
        raise DatasetError(
            "path_scenario.npy does not fit",
            expected=f"0 to {scenarios - 1}",
            got=f"{owner.min()} to {owner.max()}",
        )


def _must_be_angles(file: str, array: NDArray[Any], space: JointSpace) -> None:
    _must(file, array, np.float32, (None, space.dim))
    for start in range(0, len(array), _BLOCK):
        block = array[start : start + _BLOCK]
        inside = space.holds(block)
        if not inside.all():
            # Data sets of before limits were kept hold wrapped angles outside of them.
            inside |= circles(space.dim).holds(block)
        if not inside.all():
            raise DatasetError(
                f"{file} holds values that are no angles",
                expected="finite rad, in [-pi, pi) or within the joint's limits",
                got=str(block[~inside][0]),
                remedy="bring them there with JointSpace.to_float32 of cspace.space",
            )


def _must_be_offsets(file: str, offsets: NDArray[Any], parts: int, rows: int) -> None:
    _must(file, offsets, np.int64, (parts + 1,))
    if offsets[0] != 0 or offsets[-1] != rows or (np.diff(offsets) < 0).any():
        raise DatasetError(
            f"{file} does not fit",
            expected=f"rising from 0 to {rows}",
            got=f"from {offsets[0]} to {offsets[-1]}",
        )
