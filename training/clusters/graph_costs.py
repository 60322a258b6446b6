"""What a run of an ONNX graph costs by its own operations, on a nominal core.

Clocks would make a bundle depend on what else the machine does while it is calibrated: the same seed has to
give the same bundle. The three constants are rounded from the shipped planar model's graphs on one core of an
AMD EPYC; choices depend on their ratios alone.
"""

import math
from collections.abc import Mapping

import numpy as np
import onnx
from numpy.typing import NDArray

from cspace.bundle.running.runtime import onnx_runtime

# A multiplication with its addition in a matrix product or a convolution, an element of any other operation's
# answer, and starting an operation.
MULTIPLY_ADD_S, ELEMENT_S, NODE_S = 3e-11, 3e-10, 1.5e-6

# Other views of what is there.
_FREE = {"Constant", "Flatten", "Identity", "Reshape", "Shape", "Squeeze", "Unsqueeze"}


def run_cost(graph: bytes, rows: int, feeds: Mapping[str, NDArray[np.float32]]) -> float:
    """The cost of one run, s on a nominal core.

    Args:
        graph: an ONNX model without control flow.
        rows: of inputs whose number of rows is not fixed.
        feeds: inputs whose values decide what is computed; the others are zeros.
    """
    model = onnx.load_from_string(graph)
    fed = {one.name: feeds.get(one.name, _zeros(one, rows)) for one in model.graph.input}
    known = {one.name: tuple(one.dims) for one in model.graph.initializer}
    known |= {name: array.shape for name, array in fed.items()} | _shapes(model, fed)
    return sum(_node_cost(node, known) for node in model.graph.node)


def _zeros(one: onnx.ValueInfoProto, rows: int) -> NDArray[np.float32]:
    sizes = [size.dim_value or rows for size in one.type.tensor_type.shape.dim]
    return np.zeros(sizes, dtype=np.float32)


def _shapes(model: onnx.ModelProto, fed: Mapping[str, NDArray[np.float32]]) -> dict[str, tuple[int, ...]]:
    """Of every node's answers, by running the graph as it is written."""
    names = [name for node in model.graph.node for name in node.output if name]
    del model.graph.output[:]
    model.graph.output.extend(onnx.ValueInfoProto(name=name) for name in names)
    runtime = onnx_runtime()
    options = runtime.SessionOptions()
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.intra_op_num_threads = 1
    session = runtime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    found = session.run(names, {one.name: fed[one.name] for one in session.get_inputs()})
    return {name: np.shape(array) for name, array in zip(names, found, strict=True)}


def _node_cost(node: onnx.NodeProto, shapes: Mapping[str, tuple[int, ...]]) -> float:
    if node.op_type in _FREE:
        return 0.0
    elements = sum(math.prod(shapes[name]) for name in node.output if name)
    if node.op_type == "Conv":
        work = elements * math.prod(shapes[node.input[1]][1:]) * MULTIPLY_ADD_S
    elif node.op_type in ("Gemm", "MatMul"):
        turned = any(one.name == "transA" and one.i for one in node.attribute)
        work = elements * shapes[node.input[0]][0 if turned else -1] * MULTIPLY_ADD_S
    else:
        work = elements * ELEMENT_S
    return work + NODE_S
