"""The validity head's map: its graph made to look at a fixed grid of the joint space."""

from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from cspace.bundle.running.runtime import onnx_runtime
from training.models.lookups.grid_lookups import fast_map

MAP = "map"
# By so much the same sums in another order may differ where the head is steep.
_SAME = 1e-3


def map_graph(validity: bytes, grid: NDArray[Any]) -> bytes:
    """A graph from a picture to the head's confidences on a grid.

    Where the head is one of this project's its look-ups are rebuilt for the grid, which halves the time; the
    answer for a picture shows whether that is still the same head.

    Args:
        validity: the head's graph: ``image`` (1, 3, P, P), ``configurations`` (n, d) to ``confidence`` (n,).
        grid: (k, d) rad.

    Returns:
        ONNX bytes: ``image`` (1, 3, P, P) to ``map`` (k,).
    """
    cells = np.asarray(grid, dtype=np.float32)
    fast = fast_map(onnx.load_from_string(validity), cells)
    plain = onnx.load_from_string(validity)
    _show(plain, cells)
    if fast is not None and not _agree(fast, plain):
        fast = None
    whole = fast or plain
    named(whole, "confidence", MAP)
    (found,) = whole.graph.output
    whole.graph.output.remove(found)
    whole.graph.output.append(shaped(MAP, len(cells)))
    onnx.checker.check_model(whole)
    serialised: bytes = whole.SerializeToString()
    return serialised


def _agree(one: onnx.ModelProto, other: onnx.ModelProto) -> bool:
    """Whether two graphs say the same of a picture."""
    runtime = onnx_runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 4
    found = []
    for model in (one, other):
        graph = model.SerializeToString()
        session = runtime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
        (image,) = session.get_inputs()
        size = (1, *image.shape[1:])
        picture = np.random.default_rng(0).uniform(-1.0, 1.0, size).astype(np.float32)
        found.append(session.run(None, {"image": picture})[0])
    return found[0].shape == found[1].shape and bool(np.abs(found[0] - found[1]).max() < _SAME)


def named(model: onnx.ModelProto, name: str, wanted: str) -> None:
    """Give a value of the graph, an input or output perhaps, another name."""
    for node in model.graph.node:
        for side in (node.input, node.output):
            side[:] = [wanted if value == name else value for value in side]
    for entry in (*model.graph.input, *model.graph.output):
        entry.name = wanted if entry.name == name else entry.name


def shaped(name: str, *shape: str | int) -> onnx.ValueInfoProto:
    """A graph's float32 input or output of a shape, some of whose sizes may be names."""
    return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)


def _show(head: onnx.ModelProto, grid: NDArray[np.float32]) -> None:
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
