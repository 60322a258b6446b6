"""Bundles with one or a few things changed, their sums written again: each loads or is refused.

``python -m tests.cspace.bundle_fuzz FIRST_SEED SECONDS COUNT`` prints each seed before it is tried, so that
the last line names the one that ended the process.
"""

import json
import random
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import onnx

from cspace.bundle import Bundle, write_bundle
from cspace.bundle.golden import endpoints, scene
from cspace.bundle.graph_check import OPERATORS
from cspace.errors import BundleError
from tests.bundles import tiny_graphs, tiny_spec
from tests.cspace import hostile_graphs as hostile
from tests.cspace.test_bundle_integrity import resign

NUMBERS = (
    0, 1, 2, 3, 7, 16, 255, 4096, 65536, 2**24, 2**31 - 1, 2**31, 2**32, 2**40, 2**62, 2**63 - 1,
    -1, -2, -(2**31), -(2**63),
)  # fmt: skip
VALUES = (*NUMBERS, 2**64, 10**300, 0.5, -0.0, 1e308, "", "x", "\ud800", None, True, [], {}, [0], [[[]]])
LIMIT_S = 1.0
MEMORY_BYTES = 6 * 2**30

Change = Callable[[random.Random, Path], None]


def originals(folder: Path) -> Path:
    """One bundle with every file that a bundle can have."""
    spec = replace(tiny_spec(kind="path"), looks_at_map=True, novelty_quantiles=((0.0, 1.0), (0.0, 1.0)))
    graphs = tiny_graphs(spec, validity=True)
    # One with integers and sizes that depend on data.
    return write_bundle(folder, spec, graphs | {"encoder": hostile.chosen_rows()})


def change_bytes(rng: random.Random, folder: Path) -> None:
    """Some bytes: another value, gone, twice, or from elsewhere."""
    path = folder / rng.choice(sorted(entry.name for entry in folder.iterdir()))
    data = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, size = rng.randrange(len(data) or 1), rng.choice((1, 1, 2, 4, 16))
        kind = rng.randrange(4)
        if kind == 0:
            data[at : at + size] = rng.randbytes(size)
        elif kind == 1:
            del data[at : at + size]
        elif kind == 2:
            data[at:at] = data[at : at + size]
        else:
            other = rng.randrange(len(data) or 1)
            data[at : at + size] = data[other : other + size]
    path.write_bytes(bytes(data[: rng.choice((None, None, None, len(data) // 2))]))


def change_description(rng: random.Random, folder: Path) -> None:
    """Another value somewhere in the description."""
    path = folder / "bundle.json"
    values = json.loads(path.read_text())
    place: Any = values
    while True:
        keys = sorted(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            break
        key = rng.choice(keys)
        if isinstance(place[key], dict | list) and rng.random() < 0.7:
            place = place[key]
            continue
        place[key] = rng.choice(VALUES)
        break
    path.write_text(json.dumps(values))


def change_graph(rng: random.Random, folder: Path) -> None:
    """A few fields of a graph, each still a field of its kind."""
    path = folder / rng.choice(sorted(entry.name for entry in folder.glob("*.onnx")))
    try:
        model = onnx.load_from_string(path.read_bytes())
    except Exception:  # noqa: BLE001 - whatever protobuf says to bytes that were changed before
        return
    graphs = [model.graph]
    graphs += [entry.g for node in model.graph.node for entry in node.attribute if entry.HasField("g")]
    for _ in range(rng.choice((1, 1, 2, 4))):
        rng.choice((_operator, _wiring, _attribute, _tensor, _declared, _repeat))(rng, rng.choice(graphs))
    path.write_bytes(model.SerializeToString())


def _operator(rng: random.Random, graph: Any) -> None:
    if graph.node:
        rng.choice(graph.node).op_type = rng.choice(sorted(OPERATORS))


def _wiring(rng: random.Random, graph: Any) -> None:
    names = [name for node in graph.node for name in (*node.input, *node.output)]
    names += [each.name for each in (*graph.initializer, *graph.input)]
    node = rng.choice(graph.node) if graph.node else None
    if node is not None and node.input:
        node.input[rng.randrange(len(node.input))] = rng.choice([*names, "", "nowhere"])
    if node is not None and rng.random() < 0.3:
        node.input.append(rng.choice(names))


def _attribute(rng: random.Random, graph: Any) -> None:
    node = rng.choice(graph.node) if graph.node else None
    if node is None:
        return
    name = rng.choice(
        ("axis", "axes", "strides", "pads", "dilations", "group", "kernel_shape", "to", "keepdims",
         "blocksize", "perm", "start", "end", "num_outputs", "dtype", "k", "largest", "mode", "size")
    )  # fmt: skip
    kept = [entry for entry in node.attribute if entry.name != name]
    del node.attribute[:]
    node.attribute.extend(kept)
    many = [rng.choice(NUMBERS) for _ in range(rng.randrange(1, 5))]
    node.attribute.append(onnx.helper.make_attribute(name, many if rng.random() < 0.5 else many[0]))


def _tensor(rng: random.Random, graph: Any) -> None:
    if not graph.initializer:
        return
    tensor = rng.choice(graph.initializer)
    kind = rng.randrange(4)
    if kind == 0 and tensor.dims:
        tensor.dims[rng.randrange(len(tensor.dims))] = rng.choice(NUMBERS)
    elif kind == 1:
        tensor.data_type = rng.randrange(20)
    elif kind == 2 and tensor.data_type == onnx.TensorProto.INT64:
        count = len(tensor.raw_data) // 8
        tensor.raw_data = b"".join(
            rng.choice(NUMBERS).to_bytes(8, "little", signed=True) for _ in range(count)
        )
    else:
        tensor.raw_data = rng.randbytes(len(tensor.raw_data))


def _declared(rng: random.Random, graph: Any) -> None:
    entries = [*graph.input, *graph.output]
    if not entries:
        return
    tensor = rng.choice(entries).type.tensor_type
    if rng.random() < 0.5 and tensor.shape.dim:
        rng.choice(tensor.shape.dim).dim_value = rng.choice(NUMBERS)
    else:
        tensor.elem_type = rng.randrange(18)


def _repeat(rng: random.Random, graph: Any) -> None:
    """A node once more, under another name, in front of what it was."""
    if not graph.node:
        return
    at = rng.randrange(len(graph.node))
    twin = onnx.NodeProto()
    twin.CopyFrom(graph.node[at])
    for index, name in enumerate(twin.output):
        twin.output[index] = f"{name}_again"
    graph.node.insert(at + 1, twin)
    if at + 2 < len(graph.node) and graph.node[at + 2].input and twin.output:
        graph.node[at + 2].input[0] = twin.output[0]


CHANGES: tuple[Change, ...] = (change_bytes, change_description, change_graph, change_graph, change_graph)


def try_one(seed: int, original: Path) -> str:
    """Whether the changed bundle was loaded; anything but a BundleError passes through."""
    rng = random.Random(seed)  # noqa: S311 - a seed has to say what is tried
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for path in original.iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        rng.choice(CHANGES)(rng, folder)
        if rng.random() < 0.95:
            resign(folder)
        began = time.monotonic()
        try:
            # A golden case would refuse nearly all that onnxruntime would still compute.
            bundle = Bundle.load(folder, replay=rng.random() < 0.2, run_limit_s=LIMIT_S)
            _use(bundle)
        except BundleError as error:
            outcome = "refused by its allow-list" if "cannot be opened" in str(error) else "refused"
        else:
            outcome = "loaded"
        took = time.monotonic() - began
        if took > 10.0 * LIMIT_S:
            raise TimeoutError(f"seed {seed} took {took:.1f} s")
        return outcome


def _use(bundle: Bundle) -> None:
    """One request, of whatever the description has become."""
    start, goal = endpoints(bundle.spec.endpoints, bundle.spec.world.space)
    bundle.sample(
        scene(bundle.spec.world.sensor.picture_shape), 3, 0, start=start, goal=goal, min_confidence=0.0
    )


def main(first: int, seconds: float, count: int) -> None:
    """Try seeds from ``first`` on until time or count is spent."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    give_up = time.monotonic() + seconds
    outcomes: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as place:
        original = originals(Path(place) / "bundle")
        for seed in range(first, first + count):
            print(f"seed {seed}", file=sys.stderr, flush=True)  # noqa: T201 - the one that a crash leaves behind
            outcome = try_one(seed, original)
            outcomes[outcome] = outcomes.get(outcome, 0) + 1
            if time.monotonic() > give_up:
                break
    print(json.dumps(outcomes))  # noqa: T201 - what the test reads


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
