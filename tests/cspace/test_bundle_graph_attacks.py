"""Graphs that want more than to be computed: refused by their bytes, before onnxruntime opens them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from cspace.bundle import Bundle
from cspace.bundle.files import check_graph
from cspace.errors import BundleIntegrityError
from tests.bundles import tiny_graphs, tiny_spec
from tests.cspace.test_bundle_integrity import resign

HONEST = tiny_graphs(tiny_spec())["encoder"]
Change = Callable[[onnx.ModelProto], None]


def outside(tensor: onnx.TensorProto) -> None:
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="beside.bin")


def in_an_initializer(model: onnx.ModelProto) -> None:
    outside(model.graph.initializer[0])


def in_a_constant(model: onnx.ModelProto) -> None:
    tensor = numpy_helper.from_array(np.ones(3, np.float32))
    outside(tensor)
    model.graph.node.append(helper.make_node("Constant", [], ["more"], value=tensor))


def in_a_sparse_initializer(model: onnx.ModelProto) -> None:
    outside(model.graph.sparse_initializer.add().values)


def in_a_function(model: onnx.ModelProto) -> None:
    model.functions.add(name="local", domain="local")


def with_a_loop(model: onnx.ModelProto) -> None:
    body = helper.make_graph([], "body", [], [])
    model.graph.node.append(helper.make_node("Loop", ["", ""], ["more"], body=body))


def of_another_domain(model: onnx.ModelProto) -> None:
    model.opset_import.add(domain="com.microsoft", version=1)


def of_an_operator_of_another_domain(model: onnx.ModelProto) -> None:
    model.graph.node.append(helper.make_node("Inverse", ["image"], ["more"], domain="com.microsoft"))


def with_training(model: onnx.ModelProto) -> None:
    model.training_info.add()


def with_fewer_weights_than_told(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[0] += 1


def with_a_negative_size(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[0] = -1


CHANGES: dict[Change, str] = {
    in_an_initializer: "weights outside",
    in_a_constant: "weights outside",
    in_a_sparse_initializer: "sparse tensors",
    in_a_function: "functions",
    with_a_loop: "operators Loop",
    of_another_domain: "com.microsoft",
    of_an_operator_of_another_domain: "com.microsoft:Inverse",
    with_training: "training",
    with_fewer_weights_than_told: "a whole ONNX graph",
    with_a_negative_size: "a whole ONNX graph",
}
BYTES = (b"", HONEST[:-3], b"\x08" + b"\xff" * 11, HONEST + b"\x02\x00", HONEST + b"\x32\xff\xff\xff\xff\x0f")


@pytest.mark.parametrize(("change", "match"), CHANGES.items(), ids=lambda one: getattr(one, "__name__", ""))
def test_what_no_exporter_of_the_project_writes_is_refused(folder: Path, change: Change, match: str) -> None:
    check_graph("encoder.onnx", HONEST)
    model = onnx.load_from_string(HONEST)
    change(model)
    (folder / "encoder.onnx").write_bytes(model.SerializeToString())
    resign(folder)
    with pytest.raises(BundleIntegrityError, match=rf"encoder\.onnx cannot be opened.*{match}"):
        Bundle.load(folder)


@pytest.mark.parametrize("data", BYTES, ids=range(len(BYTES)))
def test_bytes_that_are_no_graph_of_onnx_are_refused(data: bytes) -> None:
    with pytest.raises(BundleIntegrityError, match=r"encoder\.onnx cannot be opened"):
        check_graph("encoder.onnx", data)
