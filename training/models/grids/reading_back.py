"""A head's weights read back from the graph that was exported of it."""

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

from cspace.errors import BundleError
from training.models.grids.head import GridHead

_PREFIX = "head."
# The map's graph is kept as it is; these are of the other one.
_OF_MAP = "encoder."


def read_back(head: GridHead, validity: bytes) -> None:
    """Give a head the weights that a validity graph of its kind holds; those of its encoder stay.

    Names of parameters are kept by the exporter; a layer's weight that it turned has none, and is found by
    its bias, which is added to its product.

    Args:
        head: of the same sizes.
        validity: bytes of the graph.

    Raises:
        BundleError: the graph holds none of some weights, or of other sizes.
    """
    graph = onnx.load_from_string(validity).graph
    held = {item.name: torch.from_numpy(numpy_helper.to_array(item).copy()) for item in graph.initializer}
    for name, parameter in head.named_parameters():
        if name.startswith(_OF_MAP):
            continue
        found = held.get(_PREFIX + name)
        if found is None:
            found = _turned(graph, held, _PREFIX + name.removesuffix("weight") + "bias")
        if found is None or found.shape != parameter.shape:
            raise BundleError(
                f"the validity graph holds no {name}",
                expected=f"numbers of shape {tuple(parameter.shape)}",
                got="none" if found is None else str(tuple(found.shape)),
                remedy="export the head of its checkpoint",
            )
        with torch.no_grad():
            parameter.copy_(found)


def _turned(graph: onnx.GraphProto, held: dict[str, Tensor], bias: str) -> Tensor | None:
    """The weight of which a product is made that the bias is added to."""
    sums = [node for node in graph.node if node.op_type == "Add" and bias in node.input]
    for node in graph.node:
        if node.op_type == "MatMul" and any(node.output[0] in found.input for found in sums):
            weight = held.get(node.input[1])
            return None if weight is None else weight.T
    return None
