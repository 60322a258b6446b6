"""Graphs that want more than to be computed: refused by their bytes, before onnxruntime opens them."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest

from cspace.bundle import Bundle
from cspace.bundle.onnx.check import check_graph
from cspace.bundle.onnx.operators import OPERATORS
from cspace.bundle.running import sessions as opening
from cspace.bundle.running.graphs import Graph
from cspace.errors import BundleError, BundleIntegrityError
from tests.bundles import LATENT, write_tiny_bundle
from tests.cspace import hostile_graphs as hostile
from tests.cspace.hostile_graphs import field
from tests.cspace.test_bundle_integrity import resign

OUTSIDE = [
    hostile.in_an_initializer,
    hostile.in_a_constant,
    hostile.in_a_loops_body,
    hostile.in_a_sparse_initializer,
    hostile.in_a_function,
]


def opened(model: bytes, limit_s: float = 1.0) -> Graph:
    return Graph("encoder.onnx", model, {"image"}, {"mu", "sigma"}, limit_s)


@pytest.fixture
def never_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        pytest.fail("onnxruntime saw the bytes")

    monkeypatch.setattr(opening.Session, "_opened", fail)


def test_an_honest_graph_of_the_same_making_is_opened() -> None:
    assert opened(hostile.plain()).sizes is not None
    assert opened(hostile.endless(turns=64)) is not None


@pytest.mark.parametrize("build", OUTSIDE, ids=lambda build: build.__name__)
def test_weights_outside_are_found_wherever_they_stand_and_in_any_order(
    tmp_path: Path, build: Callable[[], bytes]
) -> None:
    folder = write_tiny_bundle(tmp_path / "bundle")
    (folder / "encoder.onnx").write_bytes(build())
    (tmp_path / hostile.BESIDE).write_bytes(np.ones((3, LATENT), np.float32).tobytes())
    resign(folder)
    assert b"\n\x08location\x12" not in build()
    with pytest.raises(BundleIntegrityError, match=r"weights outside|field (15|25)|operator"):
        Bundle.load(folder)


REFUSED: dict[str, tuple[Callable[[], bytes], str]] = {
    "a loop of 2^62 turns": (hostile.endless, "Loop of"),
    "a loop without a number of turns": (hostile.endless_by_condition, "any number"),
    "a loop whose turns are computed": (hostile.endless_by_a_computed_number, "any number"),
    "loops within a loop": (hostile.nested, "nodes a run"),
    "a loop in a function": (hostile.endless_in_a_function, "field 25"),
    "functions that call each other": (hostile.recursive, "field 25"),
    "an operator of another domain": (hostile.of_another_domain, "com.microsoft"),
    "a random operator": (hostile.random, "RandomNormal"),
    "a branch": (hostile.branch, "'If'|:If"),
    "training": (hostile.trained, "field 20"),
    "deep loops": (hostile.deep, "deep"),
    "a convolution in no group": (hostile.no_group, "group"),
    "fewer weights than told": (lambda: hostile.wrong_size(LATENT + 1), "shape"),
    "more weights than can be": (lambda: hostile.wrong_size(2**40), "elements"),
    "a negative size": (lambda: hostile.wrong_size(-1), "elements"),
    "a division by -1": (lambda: hostile.dividing("Div"), "-1"),
    "a remainder by -1": (lambda: hostile.dividing("Mod"), "-1"),
    "a division by a computed -1": (lambda: hostile.dividing("Div", "computed"), "-1"),
    **{
        f"an absurd {name}": (lambda name=name: hostile.huge(name), f"absurd size by {name}")  # type: ignore[misc]
        for name in ("ConstantOfShape", "Expand", "Tile", "Range")
    },
}


@pytest.mark.usefixtures("never_opened")
@pytest.mark.parametrize(("build", "match"), REFUSED.values(), ids=REFUSED)
def test_what_no_exporter_of_the_project_writes_is_refused(build: Callable[[], bytes], match: str) -> None:
    with pytest.raises(BundleIntegrityError, match=match):
        opened(build())


WIRE = {
    "nothing": b"",
    "a torn field": hostile.plain()[:-3],
    "an endless number": b"\x08" + b"\xff" * 11,
    "a number that is longer than it has to be": b"\x08\x8a\x00" + hostile.plain(),
    "a number of 70 bits": b"\x08" + b"\xff" * 9 + b"\x7f",
    "a group": hostile.plain() + b"\x0b\x0c",
    "an unknown wire type": hostile.plain() + b"\x0f",
    "field number 0": hostile.plain() + b"\x02\x00",
    "an unknown field": hostile.plain() + field(99, b"x"),
    "a length beyond the end": hostile.plain() + b"\x32\xff\xff\xff\xff\x0f",
    "two graphs, which protobuf would merge": hostile.plain() + field(7, b""),
    "a graph as a number": field(7, 1),
    "many empty fields": hostile.plain() + field(14, b"") * 600_000,
    "notes without an end": hostile.plain() + field(6, bytes(5 * 2**20)),
    "onnxruntime's own format": b"\x08\x0a\x12\x08ORTMORTM" + hostile.plain(),
}


@pytest.mark.usefixtures("never_opened")
@pytest.mark.parametrize("data", WIRE.values(), ids=WIRE)
def test_bytes_that_have_more_than_one_reading_are_refused(data: bytes) -> None:
    with pytest.raises(BundleIntegrityError, match=r"encoder\.onnx cannot be opened"):
        opened(data)


def test_a_text_in_the_place_of_the_other_formats_name_is_that_format() -> None:
    # Bytes 4 to 8 of a valid ONNX file, as somebody would write it to pass by the check.
    made = onnx.load_from_string(hostile.plain())
    made.producer_name = "ORTM"
    data = made.SerializeToString()
    assert data[4:8] == b"ORTM"
    with pytest.raises(BundleIntegrityError, match="own format"):
        opened(data)


def test_what_is_computed_while_a_graph_is_opened_is_ended_too() -> None:
    with pytest.raises(BundleError, match="did not end in time"):
        opened(hostile.slow_to_open(), limit_s=0.3)


@pytest.mark.timeout(20)
def test_what_a_loop_that_is_never_entered_would_compute_is_not_computed() -> None:
    assert opened(hostile.slow_to_open_in_a_loop()) is not None


def test_a_refusal_names_the_file_and_no_folder(tmp_path: Path) -> None:
    folder = write_tiny_bundle(tmp_path / "bundle")
    made = onnx.load_from_string((folder / "encoder.onnx").read_bytes())
    made.graph.node[2].op_type = "Gemm"
    made.graph.node[2].input[0] = "image"
    (folder / "encoder.onnx").write_bytes(made.SerializeToString())
    resign(folder)
    with pytest.raises(BundleIntegrityError, match=r"encoder\.onnx cannot be opened") as caught:
        Bundle.load(folder)
    assert "/" not in (caught.value.got or "")
    assert str(tmp_path) not in str(caught.value)


@pytest.mark.usefixtures("never_opened")
@pytest.mark.parametrize("operator", sorted(OPERATORS - {"Loop"}))
@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_node_with_fewer_inputs_than_its_operator_takes_is_no_surprise(operator: str, count: int) -> None:
    node = hostile.node(operator, ["weights"] * count, ["number"])
    # Whether it can be computed is for onnxruntime to say.
    with contextlib.suppress(BundleIntegrityError):
        check_graph("encoder.onnx", hostile.model(hostile.graph([node])))
