"""Path models to ONNX graphs whose randomness is an input, with what a bundle's description says of them."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from cspace.bundle import RandomInput
from training.models.export import batched, exported, pictures
from training.models.lookups.lookups import Lookups
from training.models.mixture import look
from training.models.paths.condition import Condition, swept
from training.models.paths.points import PathFlow, PathGenerator
from training.paths.writing import PathGraph

PointNetwork = PathFlow | PathGenerator


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
    """The graph of a flow or a generator; pictures of a side, or of a whole size."""
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
