"""Path models to ONNX graphs whose randomness is an input, with what a bundle's description says of them."""

from collections.abc import Sequence

import numpy as np
import onnx
import torch
from onnx import compose
from torch import Tensor, nn

from cspace.bundle import RandomInput
from cspace.grid_search import centres
from cspace.space import JointSpace
from training.models.export import batched, exported, pictures
from training.models.lookups.head_map import MAP, map_graph, named, shaped
from training.models.lookups.lookups import Lookups
from training.models.mixture import look
from training.models.paths.condition import Condition, swept
from training.models.paths.density import DensitySampler
from training.models.paths.points import PathDecoder, PathFlow, RefiningGenerator
from training.models.ways.fields import way_maps_graph
from training.paths.writing import PathGraph

PointNetwork = PathFlow | PathDecoder | RefiningGenerator


class PointSampler(nn.Module):
    """A network of points as one graph, its samples in sweeps from start to goal where it takes a place.

    Args:
        net: trained.
        lookups: where it reads the picture; None without.
        place: whether it is asked for a place.
        sweep: rows from start to goal.
        jitter_rad: standard deviation of what is added to the points; 0 for nothing.
    """

    def __init__(
        self,
        net: PointNetwork,
        lookups: Lookups | None,
        *,
        place: bool,
        sweep: int,
        jitter_rad: float = 0.0,
    ) -> None:
        super().__init__()
        self.net, self.lookups, self.place, self.sweep = net, lookups, place, sweep
        self.jitter_rad = jitter_rad

    def forward(self, latent: Tensor, start: Tensor, goal: Tensor, noise: Tensor, *rest: Tensor) -> Tensor:
        """Latent, start, goal, noise, then place, jitter and picture where it takes them, to (m, 1, d)."""
        more = list(rest)
        places = swept(more.pop(0), self.sweep) if self.place else None
        jitter = more.pop(0) if self.jitter_rad > 0.0 else None
        image = more.pop(0) if self.lookups is not None else None
        points: Tensor = self.net(
            Condition(latent, start, goal, places), noise, lambda at: look(self.lookups, image, at)
        )
        if jitter is not None:
            points = self.net.joints.fold(points + self.jitter_rad * jitter)
        return points.unsqueeze(1)


def point_graph(sampler: PointSampler, latent_dim: int, pixels: int | Sequence[int]) -> PathGraph:
    """The graph of a flow, a decoder or a generator; pictures of a side, or of a whole size."""
    net, dim = sampler.net, sampler.net.joints.dim
    rows = [torch.zeros(2, size) for size in (latent_dim, dim, dim, net.noise_dim)]
    names = ["latent", "start", "goal", "noise"]
    if isinstance(net, PathFlow):
        random = [RandomInput("noise", "uniform", (dim,), -float(np.pi), float(np.pi))]
    else:
        random = [RandomInput("noise", "normal", (net.noise_dim,))]
    if sampler.place:
        rows.append(torch.zeros(2, 1))
        names.append("place")
        random.append(RandomInput("place", "uniform", (1,), 0.0, 1.0))
    if sampler.jitter_rad > 0.0:
        rows.append(torch.zeros(2, dim))
        names.append("jitter")
        random.append(RandomInput("jitter", "normal", (dim,)))
    axes = batched("latents", len(rows))
    if sampler.lookups is not None:
        rows.append(pictures(1, pixels))
        names.append("image")
        axes = (*axes, {})
    # The parameters behind the fourth are one: a tuple of its own.
    nested = (*axes[:4], tuple(axes[4:]))
    model = exported(sampler, tuple(rows), names, ["samples"], nested if len(rows) > 4 else axes)
    return PathGraph(model, tuple(random), sampler.lookups is not None)


def density_graph(sampler: DensitySampler, validity: bytes, space: JointSpace, latent_dim: int) -> PathGraph:
    """The graph of the U-Net, and that of the map which it sees, by the validity head.

    Args:
        sampler: trained.
        validity: the head's graph: ``image`` (1, 3, P, P), ``configurations`` (n, d) to ``confidence`` (n,).
        space: the joint space, of two joints.
        latent_dim: L; the latent is taken, as of all generators, and not looked at.
    """
    cells = sampler.net.grid.cells
    seen = "maps" if sampler.net.ways else MAP
    rows = (torch.zeros(sampler.net.maps * cells**2), *(torch.zeros(2, size) for size in (1, 2, 2, 2)))
    names = [seen, "place", "jitter", "start", "goal"]
    model = exported(sampler, rows, names, ["samples"], ({}, *batched("latents", 4)))
    whole = onnx.load_from_string(model)
    if sampler.net.ways:
        ways = way_maps_graph(space, cells, sampler.penalty)
        named(ways, "confidence", MAP)
        whole = _joined(ways, whole, seen, "paths/")
    whole.graph.input.append(shaped("latent", "latents", latent_dim))
    onnx.checker.check_model(whole)
    random = (RandomInput("place", "uniform", (1,), 0.0, 1.0), RandomInput("jitter", "normal", (2,)))
    grid = centres(space, (cells, cells))
    return PathGraph(whole.SerializeToString(), random, map=map_graph(validity, grid))


def _joined(first: onnx.ModelProto, second: onnx.ModelProto, through: str, prefix: str) -> onnx.ModelProto:
    """One model of two, by what one gives and the other takes; inputs of one name are one input."""
    second.ir_version = first.ir_version
    shared = {entry.name for entry in first.graph.input} & {entry.name for entry in second.graph.input}
    whole = compose.merge_models(
        first, compose.add_prefix(second, prefix, rename_outputs=False), io_map=[(through, prefix + through)]
    )
    own = {prefix + entry.name: entry.name for entry in second.graph.input}
    for node in whole.graph.node:
        for index, name in enumerate(node.input):
            node.input[index] = own.get(name, name)
    for entry in list(whole.graph.input):
        if entry.name in own:
            whole.graph.input.remove(entry)
            if own[entry.name] not in shared:
                entry.name = own[entry.name]
                whole.graph.input.append(entry)
    return whole
