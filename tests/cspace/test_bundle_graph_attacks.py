"""Graphs that want more than to be computed: refused by their bytes, before onnxruntime opens them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.graph_check import check_graph
from cspace.bundle.runtime import Graph
from cspace.errors import BundleIntegrityError
from tests.bundles import LATENT
from tests.cspace import hostile_graphs as hostile
from tests.cspace.hostile_graphs import field
from tests.cspace.test_bundle_integrity import resign

OUTSIDE = [
    hostile.in_an_initializer,
    hostile.in_a_constant,
    hostile.in_a_sparse_initializer,
    hostile.in_a_function,
]


def opened(model: bytes) -> Graph:
    check_graph("encoder.onnx", model)
    return Graph("encoder.onnx", model, {"image"}, {"mu", "sigma"})


@pytest.fixture
def never_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        pytest.fail("onnxruntime saw the bytes")

    monkeypatch.setattr(Graph, "_opened", fail)


def test_an_honest_graph_of_the_same_making_is_opened() -> None:
    assert opened(hostile.plain()) is not None


@pytest.mark.parametrize("build", OUTSIDE, ids=lambda build: build.__name__)
def test_weights_outside_are_found_wherever_they_stand_and_in_any_order(
    folder: Path, build: Callable[[], bytes]
) -> None:
    (folder / "encoder.onnx").write_bytes(build())
    (folder.parent / hostile.BESIDE).write_bytes(np.ones((3, LATENT), np.float32).tobytes())
    resign(folder)
    assert b"\n\x08location\x12" not in build()
    with pytest.raises(BundleIntegrityError, match=r"weights outside|sparse|functions|operator"):
        Bundle.load(folder)


REFUSED: dict[str, tuple[Callable[[], bytes], str]] = {
    "a loop": (lambda: hostile.endless(turns=2), "operators Loop"),
    "an operator of another domain": (hostile.of_another_domain, "com.microsoft"),
    "training": (hostile.trained, "training"),
    "fewer weights than told": (lambda: hostile.wrong_size(LATENT + 1), "cannot be opened"),
    "a negative size": (lambda: hostile.wrong_size(-1), "cannot be opened"),
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
    "field number 0": hostile.plain() + b"\x02\x00",
    "a length beyond the end": hostile.plain() + b"\x32\xff\xff\xff\xff\x0f",
    "a graph as a number": field(7, 1),
}


@pytest.mark.usefixtures("never_opened")
@pytest.mark.parametrize("data", WIRE.values(), ids=WIRE)
def test_bytes_that_are_no_graph_of_onnx_are_refused(data: bytes) -> None:
    with pytest.raises(BundleIntegrityError, match=r"encoder\.onnx cannot be opened"):
        opened(data)
