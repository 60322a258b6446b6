"""Tiny valid bundles built without torch: real graphs of a few nodes, for every test that needs a model."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from cspace.bundle import BundleSpec, GoldenCase, Provenance, RandomInput, write_bundle
from cspace.bundle.spec import WAYS
from cspace.space import JointSpace
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld

LATENT = 4
PIXELS = 48


def holds(space: JointSpace, configurations: NDArray[np.floating]) -> bool:
    """Whether all of (..., d) lie in their joints' ranges, compared in the precision of the values."""
    low, high = (np.asarray(ends, dtype=configurations.dtype) for ends in (space.lower, space.upper))
    limited = (configurations >= low) & (configurations <= high)
    exact = configurations.astype(np.float64)
    return bool(np.where(space.periodic, (exact >= -np.pi) & (exact < np.pi), limited).all())


def tiny_spec(
    robot: PlanarArm = TWO_LINK,
    *,
    kind: str = "configuration",
    samples_per_latent: int = 1,
    model_kind: str = "generator",
) -> BundleSpec:
    """The description of the tiny bundle."""
    return BundleSpec(
        world=PlanarWorld(robot),
        latent_dim=LATENT,
        kind=kind,
        model_kind=model_kind,
        samples_per_latent=samples_per_latent,
        random_inputs=(
            RandomInput("base", "uniform", (robot.dim,), -np.pi, np.pi),
            RandomInput("noise", "normal", (2,)),
        ),
        provenance=Provenance(command="tests", seeds={"global": 0}, metrics={"precision": 0.5}),
    )


def tiny_graphs(spec: BundleSpec, *, validity: bool = False, scale: float = 1.0) -> dict[str, bytes]:
    """Graphs that fit a description; another ``scale`` is another model."""
    graphs = {"encoder": _encoder(spec, scale)}
    if spec.model_kind != WAYS:
        graphs["generator"] = _generator(spec, scale)
    if spec.novelty_quantiles is not None:
        graphs["novelty"] = _novelty(spec)
    if spec.looks_at_map:
        graphs["map"] = _map(spec)
    if validity:
        graphs["validity"] = _validity(spec)
    return graphs


def write_tiny_bundle(
    folder: Path,
    robot: PlanarArm = TWO_LINK,
    *,
    kind: str = "configuration",
    samples_per_latent: int = 1,
    model_kind: str = "generator",
    validity: bool = False,
    scale: float = 1.0,
    golden: GoldenCase | None = None,
) -> Path:
    """Write a tiny bundle into ``folder`` and return it.

    Args:
        folder: must not exist.
        robot: two or more joints.
        kind: ``configuration`` or ``path``.
        samples_per_latent: K.
        model_kind: ``generator``, ``mixture`` or ``ways``.
        validity: whether it has a validity head, which likes joints near 0 rad.
        scale: another one is another model with another digest.
        golden: instead of the one that is computed.
    """
    spec = tiny_spec(robot, kind=kind, samples_per_latent=samples_per_latent, model_kind=model_kind)
    return write_bundle(folder, spec, tiny_graphs(spec, validity=validity, scale=scale), golden)


def picture(seed: int = 0, pixels: int = PIXELS) -> NDArray[np.uint8]:
    """Some picture, uint8 (pixels, pixels, 3)."""
    return np.random.default_rng(seed).integers(0, 256, (pixels, pixels, 3), dtype=np.uint8)


def _encoder(spec: BundleSpec, scale: float) -> bytes:
    nodes = [
        helper.make_node("GlobalAveragePool", ["image"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["flat"]),
        helper.make_node("MatMul", ["flat", "weights"], ["mu"]),
        helper.make_node("Sigmoid", ["mu"], ["sigma"]),
    ]
    weights = {"weights": scale * _weights(3, spec.latent_dim)}
    pixels = spec.world.sensor.pixels
    sizes = {"mu": ("b", spec.latent_dim), "sigma": ("b", spec.latent_dim)}
    return _model(nodes, {"image": ("b", 3, pixels, pixels)}, sizes, weights)


def _generator(spec: BundleSpec, scale: float) -> bytes:
    inputs: dict[str, tuple[int | str, ...]] = {"latent": ("m", spec.latent_dim)}
    inputs |= {item.name: ("m", *item.shape) for item in spec.random_inputs}
    inputs |= {"map": (3,)} if spec.looks_at_map else {}
    inputs |= dict.fromkeys(spec.endpoints, ("m", spec.dim))
    weights = {}
    nodes = []
    terms = []
    width = spec.samples_per_latent * spec.dim
    for name, size in inputs.items():
        weights[f"{name}_weights"] = np.float32(scale) * _weights(int(size[-1]), width, len(weights))
        nodes.append(helper.make_node("MatMul", [name, f"{name}_weights"], [f"{name}_term"]))
        terms.append(f"{name}_term")
    weights["shape"] = np.array([-1, spec.samples_per_latent, spec.dim])
    nodes += [
        helper.make_node("Sum", terms, ["sum"]),
        helper.make_node("Reshape", ["sum", "shape"], ["samples"]),
    ]
    return _model(nodes, inputs, {"samples": ("m", spec.samples_per_latent, spec.dim)}, weights)


def _validity(spec: BundleSpec) -> bytes:
    nodes = [
        helper.make_node("ReduceMax", ["image"], ["brightest"], keepdims=0),
        helper.make_node("Abs", ["configurations"], ["distances"]),
        helper.make_node("ReduceMean", ["distances", "axis"], ["distance"], keepdims=0),
        helper.make_node("Sub", ["brightest", "distance"], ["score"]),
        helper.make_node("Sigmoid", ["score"], ["confidence"]),
    ]
    pixels = spec.world.sensor.pixels
    inputs = {"image": (1, 3, pixels, pixels), "configurations": ("n", spec.dim)}
    return _model(nodes, inputs, {"confidence": ("n",)}, {"axis": np.array([1])})


def _novelty(spec: BundleSpec) -> bytes:
    """How bright the picture is on average, and at its brightest."""
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0),
        helper.make_node("ReduceMax", ["image"], ["brightest"], keepdims=0),
        # The latent mean is an input that these scores do not need.
        helper.make_node("ReduceMean", ["mu"], ["latent"], keepdims=0),
        helper.make_node("Mul", ["latent", "zero"], ["nothing"]),
        helper.make_node("Add", ["mean", "nothing"], ["bright"]),
        helper.make_node("Reshape", ["bright", "one"], ["first"]),
        helper.make_node("Reshape", ["brightest", "one"], ["second"]),
        helper.make_node("Concat", ["first", "second"], ["scores"], axis=0),
    ]
    pixels = spec.world.sensor.pixels
    inputs = {"image": (1, 3, pixels, pixels), "mu": (1, spec.latent_dim)}
    weights = {"zero": np.float32(0.0), "one": np.array([1])}
    return _model(nodes, inputs, {"scores": (2,)}, weights)


def _map(spec: BundleSpec) -> bytes:
    """The brightest red, green and blue."""
    node = helper.make_node("ReduceMax", ["image", "axes"], ["map"], keepdims=0)
    inputs = {"image": (1, 3, spec.world.sensor.pixels, spec.world.sensor.pixels)}
    return _model([node], inputs, {"map": (3,)}, {"axes": np.array([0, 2, 3])})


def _weights(rows: int, columns: int, key: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng([rows, columns, key]).normal(size=(rows, columns)).astype(np.float32)


def _model(
    nodes: list[onnx.NodeProto],
    inputs: Mapping[str, tuple[int | str, ...]],
    outputs: Mapping[str, tuple[int | str, ...]],
    weights: Mapping[str, NDArray[np.generic]],
) -> bytes:
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in inputs.items()],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in outputs.items()],
        [numpy_helper.from_array(array, name) for name, array in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())
