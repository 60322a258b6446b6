"""The validity head's look-ups on a grid that never changes, read faster than for any configurations.

Where the arm reads the picture is known when the graph is made, so that places and shares become constants,
and what a link shows is read once for all configurations that hold it the same way. The perceptron behind
stays as it is.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

_LOOKUPS = "lookups."
_LEVERS, _ORIGIN = "levers", "origin"
_SIDES = ("_across", "_down")
CHANNELS = 3


@dataclass(frozen=True, slots=True)
class ReadHead:
    """What a head's graph is made of.

    Args:
        levers: (2 d, 2 points), from the cosines and sines of the links' directions to shares of the frame.
        origin: (2 points,).
        weights: (3 points, hidden), of the perceptron's first layer, point after point.
        bias: name of what is added to it, where that is not a step behind it.
        product: name of what they give, (n, hidden), or without a bias (1, n, hidden).
        rest: the nodes behind it.
    """

    levers: NDArray[np.float32]
    origin: NDArray[np.float32]
    weights: NDArray[np.float32]
    bias: str | None
    product: str
    rest: tuple[onnx.NodeProto, ...]

    @classmethod
    def of(cls, head: onnx.ModelProto) -> "ReadHead | None":
        """Read a head that this project exported, in this release or before; None for any other."""
        arrays = {entry.name: entry for entry in head.graph.initializer}
        places = _places_read(arrays)
        if places is None:
            return None
        levers, origin = places
        for number, node in enumerate(head.graph.node):
            if node.op_type in ("MatMul", "Gemm") and node.input[1] in arrays:
                weights = numpy_helper.to_array(arrays[node.input[1]])
                turned = any(item.name == "transB" and item.i for item in node.attribute)
                weights = weights.T if turned else weights
                if len(weights) == CHANNELS * len(origin) // 2:
                    rest, bias = tuple(head.graph.node[number + 1 :]), [*node.input[2:], None][0]
                    return cls(levers, origin, weights, bias, node.output[0], rest)
        return None


def _places_read(
    arrays: Mapping[str, onnx.TensorProto],
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Levers and origin: of both sides of the picture together or, as is written now, of each apart."""

    def found(name: str) -> NDArray[np.float32] | None:
        names = [other for other in arrays if f".{other}".endswith(f".{_LOOKUPS}{name}")]
        return numpy_helper.to_array(arrays[names[0]]) if len(names) == 1 else None

    levers, origin = found(_LEVERS), found(_ORIGIN)
    if levers is not None and origin is not None:
        return levers, origin
    turned, starts = ([found(name + side) for side in _SIDES] for name in (_LEVERS, _ORIGIN))
    # Where both are equal, as of an arm in the picture's middle, the exporter writes one of them.
    starts = [start if start is not None else starts[0] for start in starts]
    parts = [part for part in (*turned, *starts) if part is not None]
    if len(parts) != 2 * len(_SIDES):
        return None
    return np.concatenate(parts[:2]).T, np.concatenate(parts[2:]).ravel()


def fast_map(head: onnx.ModelProto, grid: NDArray[np.float32]) -> onnx.ModelProto | None:
    """The head's graph on a grid (k, d) rad: ``image`` (1, 3, P, P) to ``confidence`` (k,).

    None for a head that is not built as this project's are.
    """
    read = ReadHead.of(head)
    if read is None:
        return None
    (image,) = [entry for entry in head.graph.input if entry.name == "image"]
    side = image.type.tensor_type.shape.dim[2].dim_value
    front = _Front(side)
    parts = [front.link(read, grid, link) for link in range(grid.shape[1])]
    whole = front.sum(parts)
    if read.bias is None:
        front.node("Unsqueeze", [whole, front.constant(np.array([0]))], read.product)
    else:
        front.node("Add", [whole, read.bias], read.product)
    kept = {name for node in [*front.nodes, *read.rest] for name in node.input}
    graph = helper.make_graph(
        [*front.nodes, *read.rest],
        "map",
        [image],
        list(head.graph.output),
        [*[entry for entry in head.graph.initializer if entry.name in kept], *front.constants],
    )
    return helper.make_model(graph, opset_imports=head.opset_import, ir_version=head.ir_version)


class _Front:
    """Nodes and constants that look pictures of ``side`` pixels up."""

    def __init__(self, side: int) -> None:
        self.side, self.nodes, self.constants = side, list[onnx.NodeProto](), list[onnx.TensorProto]()
        turned = self.node("Transpose", ["image"], perm=[0, 2, 3, 1])
        corner = self.node("Reshape", [turned, self.constant(np.array([side * side, CHANNELS]))])
        right, below, beyond = (self._rolled(corner, step) for step in (1, side, side + 1))
        # A row a pixel: itself, its right and lower neighbours, and the one beyond both.
        self.corners = self.node("Concat", [corner, right, below, beyond], axis=1)
        self.spread = self.constant(np.kron(np.eye(4), np.ones((1, CHANNELS))).astype(np.float32))
        self.gathered = self.constant(np.kron(np.ones((4, 1)), np.eye(CHANNELS)).astype(np.float32))

    def link(self, read: ReadHead, grid: NDArray[np.float32], link: int) -> str:
        """What the points that lie on one link add to the first layer, (k, hidden)."""
        joints = grid.shape[1]
        points = len(read.origin) // 2
        moved = np.abs(read.levers).reshape(2, joints, 2, points).max(axis=(0, 2)) > 0.0
        last = np.where(moved.any(axis=0), joints - 1 - np.argmax(moved[::-1], axis=0), 0)
        mine = np.flatnonzero(last == link)
        held, where = np.unique(grid[:, : link + 1], axis=0, return_inverse=True)
        padded = np.pad(held, ((0, 0), (0, joints - link - 1)))
        pixels, shares = _places(read, padded, mine, self.side)
        rows = self.node("Gather", [self.corners, self.constant(pixels)], axis=0)
        by_corner = self.node("MatMul", [self.constant(shares), self.spread])
        values = self.node("MatMul", [self.node("Mul", [rows, by_corner]), self.gathered])
        shape = self.constant(np.array([len(held), len(mine) * CHANNELS]))
        order = (CHANNELS * mine[:, None] + np.arange(CHANNELS)).ravel()
        weights = self.constant(np.ascontiguousarray(read.weights[order]))
        product = self.node("MatMul", [self.node("Reshape", [values, shape]), weights])
        return self.node("Gather", [product, self.constant(where.ravel().astype(np.int32))], axis=0)

    def sum(self, parts: list[str]) -> str:
        """All parts added."""
        return self.node("Sum", parts)

    def node(self, kind: str, inputs: list[str], name: str | None = None, **attributes: Any) -> str:
        """A node with one output; returns its name."""
        output = name or f"look_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def constant(self, array: NDArray[np.generic]) -> str:
        """An initialiser; returns its name."""
        name = f"look_constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def _rolled(self, rows: str, step: int) -> str:
        """Rows so much further on; what comes round at the end is never read."""
        zero, cut, end = (self.constant(np.array([at])) for at in (0, step, self.side**2))
        head, tail = self.node("Slice", [rows, zero, cut, zero]), self.node("Slice", [rows, cut, end, zero])
        return self.node("Concat", [tail, head], axis=0)


def _places(
    read: ReadHead, configurations: NDArray[np.float32], points: NDArray[np.intp], side: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Which pixel each point falls on, (n points,), and the shares of its four neighbours, (n points, 4)."""
    angles = np.cumsum(configurations.astype(np.float64), axis=1)
    directions = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
    count = len(read.origin) // 2
    at = directions @ read.levers.astype(np.float64) + read.origin
    place = np.clip(at * side - 0.5, 0.0, side - 1.0).reshape(len(at), 2, count)[:, :, points]
    corner = np.minimum(np.floor(place), side - 2)
    across, down = (place - corner).transpose(1, 0, 2).reshape(2, -1)
    column, row = corner.transpose(1, 0, 2).reshape(2, -1)
    shares = [(1.0 - across) * (1.0 - down), across * (1.0 - down), (1.0 - across) * down, across * down]
    return (row * side + column).astype(np.int32), np.stack(shares, axis=1).astype(np.float32)
