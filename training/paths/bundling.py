"""From a trained path model to ONNX graphs and a bundle."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from cspace.bundle import Bundle, RandomInput
from cspace.dataset import Dataset
from training.config import PathModel, PathTrainConfig
from training.jobs.job import TAG_START, Job
from training.models.autoencoders import network_size
from training.models.export import batched, exported, pictures
from training.models.lookups import Lookups, make_lookups
from training.models.mixture import look
from training.models.paths import Condition, PathFlow, PathGenerator, swept
from training.paths.writing import PathGraph, write_path_bundle
from training.trials.launch import TrialOutcome
from training.trials.paths import PathArrays, load_points

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
    if isinstance(net, PathFlow):
        random = [RandomInput("noise", "uniform", (dim,), -float(np.pi), float(np.pi))]
    else:
        random = [RandomInput("noise", "normal", (net.noise_dim,))]
    if sampler.place:
        random.append(RandomInput("place", "uniform", (1,), 0.0, 1.0))
    if sampler.jitter_rad > 0.0:
        random.append(RandomInput("jitter", "normal", (dim,)))
    shapes: dict[str, tuple[int, ...]] = {"latent": (latent_dim,), "start": (dim,), "goal": (dim,)}
    shapes |= {one.name: one.shape for one in random}
    rows, names = [torch.zeros(2, *shape) for shape in shapes.values()], list(shapes)
    axes = batched("latents", len(rows))
    if sampler.lookups is not None:
        rows.append(pictures(1, pixels))
        names.append("image")
        axes = (*axes, {})
    # The parameters behind the fourth are one: a tuple of its own.
    nested = (*axes[:4], tuple(axes[4:]))
    model = exported(sampler, tuple(rows), names, ["samples"], nested if len(rows) > 4 else axes)
    return PathGraph(model, tuple(random), sampler.lookups is not None)


def trained_bundle(
    folder: Path,
    job: Job[PathTrainConfig],
    outcome: TrialOutcome,
    arrays: PathArrays,
    source: Bundle,
    dataset: Dataset,
) -> Bundle:
    """The bundle of one of a job's trials, which is named after its model.

    Args:
        folder: of the bundle.
        job: of the trial.
        outcome: of the trial.
        arrays: that it learned from.
        source: whose encoder and head it sees with.
        dataset: of the arrays.
    """
    train, spec, name = job.config, source.spec, cast("PathModel", outcome.name)
    config = train.points_of(name)
    net = load_points(name, train, arrays, outcome.checkpoint)
    lookups = make_lookups(config.lookups, spec.world)
    points = PointSampler(net, lookups, place=config.place, sweep=train.sweep, jitter_rad=config.jitter_rad)
    graph = point_graph(points.eval(), spec.latent_dim, network_size(spec.world.sensor))
    seeds = {"training": train.seed, "data": dataset.generator_seed}
    recipe = {"path_model": name, "source_digest": source.digest, **train.to_dict()}
    recipe |= {} if job.start_run_id is None else {TAG_START: job.start_run_id}
    metrics = {**outcome.metrics, "training_s": outcome.ended_s - outcome.started_s}
    return write_path_bundle(folder, source, graph, dataset.digest, seeds, recipe, metrics)
