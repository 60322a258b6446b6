"""Pictures as tensors: what a model's world takes, told in the metadata, and checked in a request."""

from collections.abc import Iterable, Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError
from cspace.world import Examined, TensorInput, World
from inference_api.open_inference.tensor_schemas import TensorMetadata
from inference_api.open_inference.tensors import datatype_named
from inference_api.turns.costs import rows_of
from inference_api.turns.turns import Turn


def inputs_of(tensors: Iterable[TensorInput]) -> list[TensorMetadata]:
    """A model's inputs as its metadata tells them: -1 for an axis of any size."""
    return [
        TensorMetadata(
            name=one.name,
            datatype=datatype_named(one.dtype),
            shape=[-1 if isinstance(size, str) else size for size in one.shape],
        )
        for one in tensors
    ]


def read_pictures(world: World, tensors: Mapping[str, NDArray[Any]], turn: Turn) -> Examined:
    """The pictures (b, ...) that a request's inputs tell, with what is to be said of them.

    Args:
        world: of the model.
        tensors: the inputs by name.
        turn: told what reading costs, and asked between its parts.

    Raises:
        InputError: an input is missing, unknown, or of another type or shape.
        ImageError: their contents are none that are accepted.
    """
    taken = {one.name: one for one in world.tensors}
    needed = {name for name, one in taken.items() if not one.optional}
    if not needed <= set(tensors) <= set(taken):
        told = f"one with the name {next(iter(taken))}" if len(taken) == 1 else _named(taken)
        raise InputError("the inputs are wrong", expected=told, got=", ".join(tensors)[:100])
    sizes: dict[str, int] = {}
    for name, array in tensors.items():
        require_fitting(taken[name], array, sizes, remedy="POST /sample takes PNG files of any size")
    pixels = sum(array.size for array in tensors.values())
    turn.spend(rows_of(pixels=pixels, values=prod(world.sensor.picture_shape)))
    return world.examine_tensors(tensors, turn.between)


def require_fitting(
    one: TensorInput, array: NDArray[Any], sizes: dict[str, int] | None = None, remedy: str | None = None
) -> None:
    """Refuse an array that does not follow its description.

    Args:
        one: the description.
        array: what came.
        sizes: of letters that other arrays have fixed; those of this one are kept there.
        remedy: what to do instead.

    Raises:
        InputError: type or shape are others.
    """
    if not _fits(one, array, {} if sizes is None else sizes):
        raise InputError(
            f"the input {one.name} does not fit the model",
            expected=_expected(one),
            got=f"{array.dtype} of shape {list(array.shape)}",
            remedy=remedy,
        )


def _fits(one: TensorInput, array: NDArray[Any], sizes: dict[str, int]) -> bool:
    """Whether an array follows its description; the sizes of letters are kept."""
    if array.dtype != np.dtype(one.dtype).newbyteorder("<") or array.ndim != len(one.shape):
        return False
    if isinstance(one.shape[0], str) and not 1 <= array.shape[0] <= one.most:
        return False
    pairs = zip(one.shape, array.shape, strict=True)
    return all(
        size == (sizes.setdefault(told, size) if isinstance(told, str) else told) for told, size in pairs
    )


def _expected(one: TensorInput) -> str:
    told = f"{datatype_named(one.dtype)} of shape [{', '.join(map(str, one.shape))}]"
    return f"{told}, {one.shape[0]} from 1 to {one.most}" if isinstance(one.shape[0], str) else told


def _named(taken: Mapping[str, TensorInput]) -> str:
    return ", ".join(f"{name} (or without it)" if one.optional else name for name, one in taken.items())
