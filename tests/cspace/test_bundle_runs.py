"""Runs that do not end, and what may happen between the parts of those that do."""

import time
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.runtime import CHUNK_ROWS, Graph
from cspace.errors import BundleError
from tests.bundles import PIXELS, picture
from tests.cspace import hostile_graphs as hostile


def slow_graph(limit_s: float) -> Graph:
    """Products of large matrices, one after the other: minutes."""
    node = hostile.node
    nodes = [node("ReduceMean", ["image"], ["mean"], keepdims=0), node("Expand", ["mean", "side"], ["m0"])]
    for index in range(300):
        nodes += [node("MatMul", [f"m{index}", "m0"], [f"p{index}"])]
        nodes += [node("Tanh", [f"p{index}"], [f"m{index + 1}"])]
    nodes += [node("ReduceMax", ["m300"], ["number"], keepdims=0)]
    whole = hostile.model(hostile.graph(nodes, {"side": np.array([1200, 1200])}))
    return Graph("encoder.onnx", whole, {"image"}, {"mu", "sigma"}, limit_s)


def run(graph: Graph) -> object:
    image = np.zeros((1, 3, PIXELS, PIXELS), np.float32)
    return graph.run({"image": image}, {"mu": (1, 4), "sigma": (1, 4)})


@pytest.mark.timeout(20)
def test_a_run_that_does_not_end_is_ended_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    graph = slow_graph(limit_s=0.3)
    began = time.monotonic()
    with pytest.raises(BundleError, match="did not end in time"):
        run(graph)
    assert time.monotonic() - began < 5.0
    assert capfd.readouterr() == ("", "")


class StopError(Exception):
    pass


def test_between_is_called_between_the_parts_of_generator_and_head(folder: Path) -> None:
    bundle, calls = Bundle.load(folder), []
    bundle.sample(picture(), CHUNK_ROWS, 1, check_cancelled=lambda: calls.append(1))
    assert calls == []
    n = 3 * CHUNK_ROWS + 1
    found = bundle.sample(picture(), n, 1, check_cancelled=lambda: calls.append(1))
    assert len(calls) == 6
    assert found.samples.tobytes() == bundle.sample(picture(), n, 1).samples.tobytes()
    # Of a request that is filtered, between its turns.
    found = bundle.sample(picture(), 100, 1, min_confidence=0.7, check_cancelled=lambda: calls.append(1))
    assert len(calls) > 6
    assert found.samples.tobytes() == bundle.sample(picture(), 100, 1, min_confidence=0.7).samples.tobytes()


@pytest.mark.parametrize("request_", [{"n": CHUNK_ROWS + 1}, {"n": 100, "min_confidence": 0.99}])
def test_what_between_raises_passes_through(folder: Path, request_: dict[str, float]) -> None:
    def stop() -> None:
        raise StopError

    with pytest.raises(StopError):
        Bundle.load(folder).sample(picture(), seed=1, check_cancelled=stop, **request_)  # type: ignore[arg-type]
