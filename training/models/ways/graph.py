"""What is fixed in the graphs of ways: the grid, its neighbours, and what a step costs."""

import itertools
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from cspace.grid_search import centres, spacing
from cspace.space import JointSpace
from training.models.ways.steps import FAR


def way_constants(space: JointSpace, cells: int) -> dict[str, NDArray[Any]]:
    """By the names that :mod:`training.models.ways.steps` gives them.

    Args:
        space: the joint space, of two joints.
        cells: of the grid along each joint.
    """
    shape = (cells,) * space.dim
    size = spacing(space, shape)
    neighbours, lengths = _neighbours(space, shape)
    return {
        "grid": centres(space, shape).astype(np.float32),
        "grid_shape": np.array([1, 1, *shape], dtype=np.int64),
        "neighbours": neighbours,
        "step_lengths": lengths,
        "prices": np.array([size[0], size[1], np.hypot(*size)], dtype=np.float32),
        "wraps": np.array(space.periodic, dtype=np.float32),
        "beyond_rows": _beyond(cells, space.periodic[0]).reshape(-1, 1),
        "beyond_columns": _beyond(cells, space.periodic[1]).reshape(1, -1),
        "low": np.array(space.lower, dtype=np.float32),
        "size": size.astype(np.float32),
        "count": np.array(cells, dtype=np.float32),
        "strides": np.array([cells, 1], dtype=np.int64),
    }


def fixed(model: onnx.ModelProto, constants: dict[str, NDArray[Any]]) -> onnx.ModelProto:
    """The model with those of its inputs turned into initialisers."""
    for entry in [entry for entry in model.graph.input if entry.name in constants]:
        model.graph.input.remove(entry)
        model.graph.initializer.append(numpy_helper.from_array(np.asarray(constants[entry.name]), entry.name))
    return model


def _beyond(cells: int, wraps: bool) -> NDArray[np.float32]:
    line = np.zeros(cells + 2, dtype=np.float32)
    line[[0, -1]] = 0.0 if wraps else FAR
    return line


def _neighbours(space: JointSpace, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The eight cells round each cell, (8, n) int64, and the way to each, (8, n) float32 rad.

    Beyond a limit a cell is its own neighbour, too far away for any way.
    """
    place = np.indices(shape).reshape(len(shape), -1)
    sizes, wraps = np.array(shape)[:, None], np.array(space.periodic)[:, None]
    numbers, lengths = [], []
    for step in itertools.product((-1, 0, 1), repeat=len(shape)):
        if any(step):
            moved = place + np.array(step)[:, None]
            inside = np.all((moved >= 0) & (moved < sizes) | wraps, axis=0)
            there = np.ravel_multi_index(tuple(moved % sizes), shape)
            numbers.append(np.where(inside, there, np.arange(place.shape[1])))
            lengths.append(np.where(inside, np.linalg.norm(step * spacing(space, shape)), -FAR))
    return np.array(numbers, dtype=np.int64), np.array(lengths, dtype=np.float32)
