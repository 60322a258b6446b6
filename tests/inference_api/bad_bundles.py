"""Bundles with true sums whose graphs attack whoever runs them; their golden cases are another's."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from cspace.bundle.files import ENCODER_FILE, SUMS_FILE, sums_of
from tests.bundles import tiny_spec, write_tiny_bundle


def write_slow_bundle(folder: Path) -> Path:
    """Its encoder multiplies matrices for minutes, each product within what a graph may have."""
    nodes = [
        *_flat_picture(),
        helper.make_node("ReduceMean", ["flat"], ["at0"], keepdims=0),
        helper.make_node("Expand", ["at0", "side"], ["wide"]),
    ]
    last = "wide"
    for index in range(2000):
        nodes += [
            helper.make_node("MatMul", [last, "wide"], [f"product{index}"]),
            helper.make_node("Tanh", [f"product{index}"], [f"small{index}"]),
        ]
        last = f"small{index}"
    nodes += [
        helper.make_node("ReduceMax", [last], ["most"], keepdims=0),
        helper.make_node("Add", ["flat", "most"], ["mu"]),
        helper.make_node("Sigmoid", ["mu"], ["sigma"]),
    ]
    return _write(folder, nodes, {"side": np.array([1500, 1500])})


def write_hungry_bundle(folder: Path) -> Path:
    """Its encoder wants 1 GiB while it runs: 16 tensors of 64 MiB that live together."""
    nodes = [*_flat_picture(), helper.make_node("ReduceMean", ["flat"], ["at"], keepdims=0)]
    for index in range(16):
        nodes += [
            helper.make_node("Add", ["at", f"c{index}"], [f"s{index}"]),
            helper.make_node("Expand", [f"s{index}", "size"], [f"t{index}"]),
        ]
    nodes += [
        helper.make_node("Max", [f"t{index}" for index in range(16)], ["largest"]),
        helper.make_node("ReduceMax", ["largest"], ["most"], keepdims=0),
        helper.make_node("Add", ["flat", "most"], ["mu"]),
        helper.make_node("Sigmoid", ["mu"], ["sigma"]),
    ]
    weights = {"size": np.array([2**24]), **{f"c{index}": np.float32(index) for index in range(16)}}
    return _write(folder, nodes, weights)


def _flat_picture() -> list[onnx.NodeProto]:
    return [
        helper.make_node("GlobalAveragePool", ["image"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["three"]),
        helper.make_node("MatMul", ["three", "weights"], ["flat"]),
    ]


def _write(folder: Path, nodes: list[onnx.NodeProto], weights: dict[str, NDArray[Any]]) -> Path:
    spec = tiny_spec()
    weights = {**weights, "weights": np.ones((3, spec.latent_dim), np.float32)}
    graph = helper.make_graph(
        nodes,
        "bad",
        [
            helper.make_tensor_value_info(
                "image", TensorProto.FLOAT, ["b", 3, *spec.world.sensor.picture_shape[:2]]
            )
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["b", 4]) for name in ("mu", "sigma")],
        [numpy_helper.from_array(array, name) for name, array in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    # Beside the writer, which would run it.
    write_tiny_bundle(folder)
    (folder / ENCODER_FILE).write_bytes(model.SerializeToString())
    contents = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != SUMS_FILE}
    (folder / SUMS_FILE).write_bytes(sums_of(contents))
    return folder
