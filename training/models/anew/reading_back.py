"""A head's weights read back from the graph that was exported of it."""

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from cspace.errors import BundleError

_PREFIX = "head."
# The map's graph is kept as it is; these are of the other one.
_OF_MAP = "encoder."


def read_back(head: nn.Module, validity: bytes) -> None:
    """Give a head the weights that a validity graph of its kind holds; those of its encoder stay.

    Names of parameters are kept by the exporter; what it turned has none. A layer's weight is then found by
    its bias, which is added to its product, or the other way round, and the names of groups by their shape.

    Args:
        head: of the same kind and sizes.
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
            found = _turned(graph, held, _PREFIX + name, parameter.shape)
        if found is None or found.shape != parameter.shape:
            raise BundleError(
                f"the validity graph holds no {name}",
                expected=f"numbers of shape {tuple(parameter.shape)}",
                got="none" if found is None else str(tuple(found.shape)),
                remedy="export the head of its checkpoint",
            )
        with torch.no_grad():
            parameter.copy_(found)


def _turned(graph: onnx.GraphProto, held: dict[str, Tensor], name: str, shape: torch.Size) -> Tensor | None:
    layer, _, kind = name.rpartition(".")
    if kind not in ("weight", "bias"):
        found = [values for values in held.values() if values.shape == (*shape[::-1], 1)]
        return found[0].squeeze(-1).T if len(found) == 1 else None
    for product in graph.node:
        after = [node for node in graph.node if node.op_type == "Add" and product.output[0] in node.input]
        if product.op_type != "MatMul" or not after:
            continue
        if kind == "weight" and f"{layer}.bias" in after[0].input:
            weight = held.get(product.input[1])
            return None if weight is None else weight.T
        if kind == "bias" and f"{layer}.weight" in product.input:
            columns = [held[other] for other in after[0].input if other in held]
            return columns[0].flatten() if columns else None
    return None
