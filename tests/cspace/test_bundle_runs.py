"""Runs that do not end, and what may happen between the parts of those that do."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.golden import GoldenCase
from cspace.bundle.runtime import CHUNK_ROWS, Deadlines, Graph
from cspace.errors import BundleError, GoldenMismatchError
from tests.bundles import PIXELS, picture
from tests.cspace import hostile_graphs as hostile
from tests.cspace.test_bundle_integrity import resign


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


def test_what_ends_in_time_is_not_ended() -> None:
    deadlines, ended = Deadlines(), []
    with deadlines.ended_by(0.05, lambda: ended.append("late")):
        pass
    deadlines.begin("slow", 0.01, lambda: ended.append("slow"))
    give_up = time.monotonic() + 10.0
    while not ended and time.monotonic() < give_up:
        time.sleep(0.01)
    assert ended == ["slow"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_child_process_has_its_own_watch() -> None:
    deadlines = Deadlines()
    deadlines.begin("parent", 60.0, lambda: None)
    child = os.fork()
    if child == 0:
        ended: list[int] = []
        deadlines.begin("child", 0.01, lambda: ended.append(1))
        give_up = time.monotonic() + 5.0
        while not ended and time.monotonic() < give_up:
            time.sleep(0.01)
        os._exit(0 if ended else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    deadlines.done("parent")


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


def test_without_a_replay_all_but_the_golden_case_is_checked(folder: Path) -> None:
    case = GoldenCase.from_npz((folder / "golden.npz").read_bytes())
    other = GoldenCase(**{name: getattr(case, name) for name in case.__slots__} | {"mu": case.mu + 1.0})
    (folder / "golden.npz").write_bytes(other.to_npz())
    resign(folder)
    with pytest.raises(GoldenMismatchError):
        Bundle.load(folder)
    assert Bundle.load(folder, replay=False).has_validity
    (folder / "encoder.onnx").write_bytes(hostile.endless())
    with pytest.raises(BundleError, match="changed"):
        Bundle.load(folder, replay=False)
    resign(folder)
    with pytest.raises(BundleError, match="Loop"):
        Bundle.load(folder, replay=False)
