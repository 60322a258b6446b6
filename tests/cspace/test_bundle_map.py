"""What a bundle's map graph makes of a picture, once for all requests, and the generator of that."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from cspace.bundle import Bundle, write_bundle
from cspace.errors import BundleIntegrityError
from tests.bundles import PIXELS, picture, tiny_graphs, tiny_spec

SPEC = replace(tiny_spec(kind="path"), looks_at_map=True)
ENDS = {"start": (0.0, 1.0), "goal": (2.0, -1.0)}


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_bundle(tmp_path_factory.mktemp("map") / "bundle", SPEC, tiny_graphs(SPEC)))


def test_samples_depend_on_the_map_and_not_on_who_made_it(bundle: Bundle) -> None:
    image = picture(3)
    prepared = bundle.prepare(image)
    whole = bundle.sample(image, 50, 1, **ENDS).samples
    np.testing.assert_array_equal(bundle.sample(prepared, 50, 1, **ENDS).samples, whole)
    other = replace(prepared, map=np.zeros(3, np.float32))
    assert np.abs(bundle.sample(other, 50, 1, **ENDS).samples - whole).max() > 0.1


def test_graph_and_description_come_together(tmp_path: Path) -> None:
    without = tiny_spec(kind="path")
    with pytest.raises(BundleIntegrityError, match=r"map\.onnx without"):
        write_bundle(
            tmp_path / "no-condition", without, tiny_graphs(without) | {"map": tiny_graphs(SPEC)["map"]}
        )
    graphs = tiny_graphs(SPEC)
    del graphs["map"]
    with pytest.raises(BundleIntegrityError, match=r"map\.onnx without"):
        write_bundle(tmp_path / "no-graph", SPEC, graphs)


def test_a_map_whose_size_depends_on_the_picture_is_refused(tmp_path: Path) -> None:
    nodes = [
        helper.make_node("Reshape", ["image", "flat"], ["pixels"]),
        helper.make_node("Greater", ["pixels", "zero"], ["bright"]),
        helper.make_node("Compress", ["pixels", "bright"], ["map"], axis=0),
    ]
    constants = {"flat": np.array([-1]), "zero": np.float32(0.0)}
    graph = helper.make_graph(
        nodes,
        "bright",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, PIXELS, PIXELS))],
        [helper.make_tensor_value_info("map", TensorProto.FLOAT, ("k",))],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    graphs = tiny_graphs(SPEC) | {"map": model.SerializeToString()}
    with pytest.raises(BundleIntegrityError, match="the shape of map is not fixed"):
        write_bundle(tmp_path / "bundle", SPEC, graphs)
