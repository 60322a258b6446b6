"""A path sampler that needs no training on paths: the validity head's map, the cheapest way, a tube round it.

The head tells how free each cell of a grid over the joint space is. Sweeps over the grid spread what the way
to the goal costs, a walk from the start follows it, and the samples lie round points at random shares of the
way's length. All of that is one ONNX graph, so that a bundle holds it as any other generator.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import compose, helper, inliner, numpy_helper

from cspace.errors import ConfigError
from cspace.grid_search import centres, spacing
from cspace.space import JointSpace
from training.models.way_steps import FAR, way_samples

PLANE = 2


@dataclass(frozen=True, slots=True)
class WaySettings:
    """How the way is found.

    Args:
        cells: along each joint.
        penalty: what a rad costs more where the head is sure of a collision. No cell is ruled out, for what
            is narrower than a cell looks half blocked.
        levels: a confidence is read in so many steps; what differs by rounding alone is the same way on every
            machine.
        sweeps: how often costs spread, and the longest way in cells.
        tube_rad: standard deviation of the samples about the way.

    Raises:
        ConfigError: a value is out of its range.
    """

    cells: int = 48
    penalty: float = 20.0
    levels: int = 64
    sweeps: int = 64
    tube_rad: float = 0.1

    def __post_init__(self) -> None:
        for name, least in (("cells", 3), ("levels", 1), ("sweeps", 1), ("penalty", 0), ("tube_rad", 0)):
            value = getattr(self, name)
            if not least <= value < math.inf:
                raise ConfigError(f"{name} is out of range", expected=f"at least {least}", got=repr(value))


def way_graph(
    validity: bytes, space: JointSpace, latent_dim: int, settings: WaySettings | None = None
) -> bytes:
    """A bundle's path sampler by the map of its validity head.

    Args:
        validity: the head's graph: ``image`` (1, 3, P, P), ``configurations`` (n, d) to ``confidence`` (n,).
        space: the joint space, of two joints.
        latent_dim: L; the latent is taken, as of all generators, and not looked at.
        settings: how the way is found.

    Returns:
        ONNX bytes: ``latent`` (m, L), ``place`` (m, 1) in [0, 1), ``jitter`` (m, 2) standard normal,
        ``image`` (1, 3, P, P), ``start`` and ``goal`` (m, 2) rad, all rows alike, to ``samples`` (m, 1, 2)
        rad.

    Raises:
        ConfigError: the space has not two joints.
    """
    settings = settings or WaySettings()
    if space.dim != PLANE:
        raise ConfigError(
            "ways are searched on a grid of two joints", expected="2 joints", got=str(space.dim)
        )
    constants = _constants(space, settings)
    source = way_samples.to_model_proto()  # type: ignore[no-untyped-call]
    ways = inliner.inline_local_functions(source)
    _fix(ways, constants)
    head = onnx.load_from_string(validity)
    _show(head, constants["grid"])
    ways.ir_version = head.ir_version
    whole = compose.merge_models(
        compose.add_prefix(head, "head/", rename_inputs=False, rename_outputs=False),
        compose.add_prefix(ways, "ways/", rename_inputs=False, rename_outputs=False),
        io_map=[("confidence", "confidence")],
    )
    (samples,) = whole.graph.output
    whole.graph.output.remove(samples)
    whole.graph.output.append(_shaped("samples", "latents", 1, PLANE))
    whole.graph.input.append(_shaped("latent", "latents", latent_dim))
    onnx.checker.check_model(whole)
    serialised: bytes = whole.SerializeToString()
    return serialised


def _constants(space: JointSpace, settings: WaySettings) -> dict[str, NDArray[Any]]:
    shape = (settings.cells,) * space.dim
    size = spacing(space, shape)
    neighbours, lengths = _neighbours(space, shape)
    return {
        "grid": centres(space, shape).astype(np.float32),
        "grid_shape": np.array([1, 1, *shape], dtype=np.int64),
        "neighbours": neighbours,
        "step_lengths": lengths,
        "prices": np.array([size[0], size[1], np.hypot(*size)], dtype=np.float32),
        "wraps": np.array(space.periodic, dtype=np.float32),
        "beyond_rows": _beyond(settings.cells, space.periodic[0]).reshape(-1, 1),
        "beyond_columns": _beyond(settings.cells, space.periodic[1]).reshape(1, -1),
        "low": np.array(space.lower, dtype=np.float32),
        "size": size.astype(np.float32),
        "count": np.array(settings.cells, dtype=np.float32),
        "strides": np.array([settings.cells, 1], dtype=np.int64),
        "penalty": np.array(settings.penalty, dtype=np.float32),
        "levels": np.array(settings.levels, dtype=np.float32),
        "sweeps": np.array(settings.sweeps, dtype=np.int64),
        "tube": np.array(settings.tube_rad, dtype=np.float32),
    }


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


def _show(head: onnx.ModelProto, grid: NDArray[Any]) -> None:
    """Let the head look at the grid.

    The number of its cells comes from the picture's shape, so that it is not known before the graph runs:
    with fixed shapes onnxruntime turns the look-ups into an order that takes twice as long.
    """
    (entry,) = [entry for entry in head.graph.input if entry.name == "configurations"]
    head.graph.input.remove(entry)
    ends = {"grid_begin": [0], "grid_axis": [0], "grid_more": [len(grid) - 1]}
    for name, value in ends.items():
        head.graph.initializer.append(numpy_helper.from_array(np.array(value, dtype=np.int64), name))
    head.graph.initializer.append(numpy_helper.from_array(grid, "grid_all"))
    nodes = [
        helper.make_node("Shape", ["image"], ["grid_pictures"], start=0, end=1),
        helper.make_node("Add", ["grid_pictures", "grid_more"], ["grid_end"]),
        helper.make_node("Slice", ["grid_all", "grid_begin", "grid_end", "grid_axis"], ["configurations"]),
    ]
    for node in reversed(nodes):
        head.graph.node.insert(0, node)
    # One picture, as the head takes it; said as if there could be several.
    (image,) = [entry for entry in head.graph.input if entry.name == "image"]
    image.type.tensor_type.shape.dim[0].dim_param = "pictures"


def _fix(model: onnx.ModelProto, constants: dict[str, NDArray[Any]]) -> None:
    """Turn inputs into initialisers."""
    for entry in [entry for entry in model.graph.input if entry.name in constants]:
        model.graph.input.remove(entry)
        model.graph.initializer.append(numpy_helper.from_array(np.asarray(constants[entry.name]), entry.name))


def _shaped(name: str, *shape: str | int) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
