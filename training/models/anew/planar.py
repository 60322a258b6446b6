"""The sampler and the head of a planar bundle, read back from its graphs and exported as this release does.

Sizes come from the training's configuration, which the bundle tells, weights from its graphs: parameters
have kept their names there, but for the clusters' generators, which earlier releases stacked.
"""

from collections.abc import Mapping
from typing import Any

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

from cspace.bundle import Bundle, BundleSpec
from cspace.bundle.files import GENERATOR_FILE, VALIDITY_FILE
from cspace.errors import BundleError
from training.models.anew.reading_back import read_back
from training.models.cells import CellPoints
from training.models.export import mixture_graph, validity_graph
from training.models.gate import Gate
from training.models.lookups.lookups import ArmLookups, make_lookups, values_read
from training.models.mixture import Experts, GatedSampler
from training.models.networks import Sizes, TorusGenerator
from training.models.settings import LookupConfig
from training.models.validity import ValidityHead

MIXTURE = "mixture"


def planar_graphs(source: Bundle) -> dict[str, bytes]:
    """The graphs of a planar bundle that can be exported anew: that of its head, and that of a mixture.

    Raises:
        BundleError: it has neither, or sizes and weights do not make one.
    """
    spec, graphs = source.spec, dict[str, bytes]()
    try:
        if source.has_validity:
            head = head_of(spec, (source.folder / VALIDITY_FILE).read_bytes())
            graphs["validity"] = validity_graph(head, spec.pixels, spec.dim)
        if spec.model_kind == MIXTURE:
            sampler = sampler_of(spec, (source.folder / GENERATOR_FILE).read_bytes())
            graphs["generator"] = mixture_graph(sampler, spec.latent_dim, sampler.noise_dim, spec.pixels)
    except (KeyError, IndexError, TypeError, ValueError, RuntimeError) as error:
        raise BundleError(
            "the bundle's graphs cannot be exported anew",
            expected="the training's configuration, and weights that fit it",
            got=f"{type(error).__name__}: {str(error)[:200]}",
        ) from error
    if not graphs:
        raise BundleError(
            "the bundle cannot be exported anew",
            expected="a validity head, or a mixture",
            got=spec.model_kind,
        )
    return graphs


def head_of(spec: BundleSpec, validity: bytes) -> ValidityHead:
    """The validity head of a graph."""
    sizes = spec.provenance.config["validity"]
    lookups = ArmLookups(spec.world, int(sizes["points_per_link"]), float(sizes["side_m"]))
    head = ValidityHead(lookups, int(sizes["hidden"]), int(sizes["layers"]))
    read_back(head, validity)
    return head.eval()


def sampler_of(spec: BundleSpec, generator: bytes) -> GatedSampler:
    """The gated sampler of a graph."""
    graph = onnx.load_from_string(generator).graph
    held = {item.name: torch.from_numpy(numpy_helper.to_array(item).copy()) for item in graph.initializer}
    sizes, gate_sizes = spec.provenance.config["local"], spec.provenance.config["gate"]
    cells, size = int(gate_sizes["cells"]), int(gate_sizes["points"])
    gate = Gate(spec.latent_dim, int(gate_sizes["hidden"]), int(gate_sizes["layers"]), cells)
    gate.load_state_dict(_below(held, "gate."))
    lookups = make_lookups(LookupConfig(**sizes["generator_lookups"]), spec.world)
    looked_up = values_read(lookups)
    shape = Sizes(spec.world.space, spec.latent_dim, int(sizes["hidden"]), int(sizes["layers"]), looked_up)
    generators = []
    for weights in _networks(held | _biases(graph, held)):
        one = TorusGenerator(shape, int(sizes["noise_dim"]))
        one.residual.load_state_dict(weights)
        generators.append(one)
    per_cell = _read_at(graph, held, (cells,))
    (spacing,) = (values for values in per_cell if values.is_floating_point())
    clusters = [values for values in per_cell if not values.is_floating_point()]
    experts = Experts(generators, clusters[0] if clusters else torch.zeros(cells, dtype=torch.int64))
    points = [held["points"]] if "points" in held else _read_at(graph, held, (cells * size, spec.dim))
    found = CellPoints(points[0].view(cells, size, spec.dim).numpy(), spacing.numpy())
    return GatedSampler(gate, found, experts, lookups).eval()


def _below(held: Mapping[str, Tensor], prefix: str) -> dict[str, Any]:
    return {name.removeprefix(prefix): value for name, value in held.items() if name.startswith(prefix)}


def _biases(graph: onnx.GraphProto, held: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Biases, by the names that belong to their weights; a bias of zeros is left out by the exporter."""
    found = {}
    for node in graph.node:
        name, _, kind = node.input[1].rpartition(".") if node.op_type == "Gemm" else ("", "", "")
        if kind == "weight":
            weight = held[node.input[1]]
            found[f"{name}.bias"] = (
                held[node.input[2]] if len(node.input) > 2 else weight.new_zeros(len(weight))
            )
    return found


def _networks(held: Mapping[str, Tensor]) -> list[dict[str, Any]]:
    """The states of the clusters' perceptrons: each by itself, or as earlier releases stacked them."""
    stacked = _below(held, "experts.weights.")
    if not stacked:
        named = _below(held, "experts.networks.")
        count = 1 + max(int(name.partition(".")[0]) for name in named)
        return [_below(named, f"{index}.") for index in range(count)]
    states: list[dict[str, Any]] = [{} for _ in stacked["0"]]
    for index, state in enumerate(states):
        for level, weight in stacked.items():
            # Between two layers lies their activation.
            layer, bias = 2 * int(level), held[f"experts.biases.{level}"]
            state |= {f"{layer}.weight": weight[index].T, f"{layer}.bias": bias[index, 0]}
    return states


def _read_at(graph: onnx.GraphProto, held: Mapping[str, Tensor], shape: tuple[int, ...]) -> list[Tensor]:
    """Constants of a shape that the graph picks rows of: by cell spacing and cluster, by point the point.

    The exporter gives names of its own to what it has computed beforehand.
    """
    read = [node.input[0] for node in graph.node if node.op_type in ("Gather", "GatherND")]
    return [held[name] for name in dict.fromkeys(read) if name in held and held[name].shape == shape]
