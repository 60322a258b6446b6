"""Bundles with true sums whose graphs attack whoever runs them; their golden cases are another's."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from cspace.bundle.files import ENCODER_FILE, SUMS_FILE, sums_of
from cspace.bundle.onnx.loops import MAX_TURNS
from tests.bundles import tiny_spec, write_tiny_bundle


def write_looping_bundle(folder: Path) -> Path:
    """Its encoder goes round as often as a bundle's may, for minutes; one without end would not be opened."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["go_on"]),
            helper.make_node("ReduceMean", ["at"], ["mean"], keepdims=1),
            helper.make_node("Expand", ["mean", "side"], ["wide"]),
            helper.make_node("MatMul", ["wide", "wide"], ["product"]),
            helper.make_node("ReduceMean", ["product"], ["small"], keepdims=1),
            helper.make_node("Tanh", ["small"], ["smaller"]),
            helper.make_node("Mul", ["at", "smaller"], ["next"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("round", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("at", TensorProto.FLOAT, [1, 4]),
        ],
        [
            helper.make_tensor_value_info("go_on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("next", TensorProto.FLOAT, [1, 4]),
        ],
    )
    nodes = [
        *_flat_picture(),
        helper.make_node("Loop", ["rounds", "yes", "flat"], ["mu"], body=body),
        helper.make_node("Sigmoid", ["mu"], ["sigma"]),
    ]
    weights = {"rounds": np.array(MAX_TURNS), "yes": np.bool_(1), "side": np.array([1024, 1024])}
    return _write(folder, nodes, weights)


def write_hungry_bundle(folder: Path) -> Path:
    """Its encoder wants 40 GB, by a size that is known when it runs and not before."""
    nodes = [
        *_flat_picture(),
        helper.make_node("Cast", ["flat"], ["whole"], to=TensorProto.INT64),
        helper.make_node("ReduceSum", ["whole"], ["sum"], keepdims=0),
        helper.make_node("Mul", ["sum", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "huge"], ["size"]),
        helper.make_node(
            "ConstantOfShape", ["size"], ["heap"], value=numpy_helper.from_array(np.ones(1, "f"))
        ),
        helper.make_node("ReduceMax", ["heap"], ["most"], keepdims=0),
        helper.make_node("Add", ["flat", "most"], ["mu"]),
        helper.make_node("Sigmoid", ["mu"], ["sigma"]),
    ]
    weights = {"zero": np.array(0), "huge": np.array([10**10])}
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
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["b", 3, spec.pixels, spec.pixels])],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("mu", "sigma")],
        [numpy_helper.from_array(array, name) for name, array in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    # Beside the writer, which would run it.
    write_tiny_bundle(folder)
    (folder / ENCODER_FILE).write_bytes(model.SerializeToString())
    contents = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != SUMS_FILE}
    (folder / SUMS_FILE).write_bytes(sums_of(contents))
    return folder
