"""Encoder graphs as somebody would write them who wants more from a bundle than an answer."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from tests.bundles import LATENT, PIXELS

BESIDE = "beside.bin"
FLOAT, INT64, BOOL = TensorProto.FLOAT, TensorProto.INT64, TensorProto.BOOL
node = helper.make_node
value = helper.make_tensor_value_info


def varint(number: int) -> bytes:
    data = b""
    while number > 0x7F:
        data, number = data + bytes([number & 0x7F | 0x80]), number >> 7
    return data + bytes([number])


def field(number: int, payload: bytes | int) -> bytes:
    """One field of a protobuf message."""
    if isinstance(payload, int):
        return varint(number << 3) + varint(payload)
    return varint(number << 3 | 2) + varint(len(payload)) + payload


def external(name: str = "weights") -> bytes:
    """A tensor of (3, L) float32 outside of the bundle, its entry's value before its key."""
    entry = field(2, BESIDE.encode()) + field(1, b"location")
    dims = field(1, 3) + field(1, LATENT)
    return dims + field(2, FLOAT) + field(8, name.encode()) + field(13, entry) + field(14, 1)


def graph(nodes: Sequence[Any], constants: Mapping[str, Any] | None = None) -> onnx.GraphProto:
    """An encoder's graph from nodes or constants that give ``mu`` or a ``number`` to add to it."""
    given = {name for each in nodes for name in each.output}
    ends = [node("Sigmoid", ["mu"], ["sigma"])]
    if "mu" not in given:
        ends = [
            node("GlobalAveragePool", ["image"], ["pooled"]),
            node("Flatten", ["pooled"], ["flat"]),
            node("MatMul", ["flat", "weights"], ["plain"]),
            node("ReduceMax", ["number"], ["largest"], keepdims=0),
            node("Add", ["plain", "largest"], ["mu"]),
            *ends,
        ]
    constants = {"weights": np.ones((3, LATENT), np.float32), **(constants or {})}
    if "weights" in given:
        del constants["weights"]
    sizes = {"mu": ("b", LATENT), "sigma": ("b", LATENT)}
    return helper.make_graph(
        [*nodes, *ends],
        "encoder",
        [value("image", FLOAT, ("b", 3, PIXELS, PIXELS))],
        [value(name, FLOAT, size) for name, size in sizes.items()],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in constants.items()],
    )


def model(whole: onnx.GraphProto, functions: Sequence[Any] = (), domains: Sequence[str] = ()) -> bytes:
    """The bytes of an encoder."""
    opsets = [helper.make_opsetid("", 18), *(helper.make_opsetid(domain, 1) for domain in domains)]
    made = helper.make_model(whole, opset_imports=opsets, ir_version=10, functions=list(functions))
    return bytes(made.SerializeToString())


def with_raw(whole: bytes, number: int, payload: bytes) -> bytes:
    """A model whose graph has one more field, whose bytes stay as they are."""
    made = onnx.load_from_string(whole)
    inner = made.graph.SerializeToString() + field(number, payload)
    made.ClearField("graph")
    return bytes(made.SerializeToString()) + field(7, inner)


def loop(turns: Any, body_nodes: Sequence[Any] = (), after: Sequence[Any] = ()) -> list[Any]:
    """A loop over ``x`` of so many turns, a name or "" for none."""
    body = helper.make_graph(
        [*body_nodes, node("Identity", ["go"], ["on"]), node("Sin", ["x"], ["next_x"])],
        "body",
        [value("i", INT64, ()), value("go", BOOL, ()), value("x", FLOAT, (1,))],
        [value("on", BOOL, ()), value("next_x", FLOAT, (1,))],
    )
    return [node("Loop", [turns, "true", "begin"], ["number"], body=body), *after]


LOOPED = {"true": np.ones((), bool), "begin": np.ones(1, np.float32)}


def in_an_initializer() -> bytes:
    whole = graph([], {"number": np.float32(0.0)})
    del whole.initializer[0]
    return with_raw(model(whole), 5, external())


def constant_node(output: str) -> bytes:
    """A Constant whose tensor lies outside."""
    attribute = field(1, b"value") + field(5, external("")) + field(20, onnx.AttributeProto.TENSOR)
    return field(2, output.encode()) + field(4, b"Constant") + field(5, attribute)


def in_a_constant() -> bytes:
    whole = graph([], {"number": np.float32(0.0)})
    del whole.initializer[0]
    nodes = b"".join(field(1, each.SerializeToString()) for each in whole.node)
    del whole.node[:]
    inner = field(1, constant_node("weights")) + nodes + whole.SerializeToString()
    made = onnx.load_from_string(model(helper.make_graph([], "none", [], [])))
    made.ClearField("graph")
    return bytes(made.SerializeToString()) + field(7, inner)


def in_a_sparse_initializer() -> bytes:
    return with_raw(model(graph([], {"number": np.float32(0.0)})), 15, field(1, external("sparse")))


def in_a_function() -> bytes:
    """A function of the model's own whose constant lies outside."""
    function = field(1, b"outside") + field(5, b"weights") + field(7, constant_node("weights"))
    function += field(9, helper.make_opsetid("", 18).SerializeToString()) + field(10, b"local")
    called = node("outside", [], ["weights"], domain="local")
    return model(graph([called], {"number": np.float32(0.0)}), domains=["local"]) + field(25, function)


def endless(turns: int = 2**62) -> bytes:
    return model(graph(loop("turns"), {**LOOPED, "turns": np.int64(turns)}))


def of_another_domain() -> bytes:
    called = node("Inverse", ["square"], ["number"], domain="com.microsoft")
    return model(graph([called], {"square": np.eye(2, dtype=np.float32)}), domains=["com.microsoft"])


def wrong_size(size: int) -> bytes:
    """Weights of another size than their bytes."""
    made = onnx.load_from_string(model(graph([], {"number": np.float32(0.0)})))
    made.graph.initializer[0].dims[1] = size
    return bytes(made.SerializeToString())


def trained() -> bytes:
    return model(graph([], {"number": np.float32(0.0)})) + field(20, field(1, b""))


def plain() -> bytes:
    return model(graph([], {"number": np.float32(0.0)}))
