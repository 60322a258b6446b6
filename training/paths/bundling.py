"""From a trained path model to ONNX graphs and a bundle."""

from pathlib import Path

import torch
from torch import Tensor, nn

from cspace.bundle import Bundle, RandomInput
from cspace.dataset import Dataset
from training.config import PathTrainConfig
from training.jobs.job import TAG_START, Job
from training.models.export import batched, exported
from training.models.paths import Condition, PathGenerator
from training.paths.writing import PathGraph, write_path_bundle
from training.trials.launch import TrialOutcome
from training.trials.paths import PathArrays, load_points


class PointSampler(nn.Module):
    """A generator of points as one graph: latent, start, goal and noise to (m, 1, d)."""

    def __init__(self, net: PathGenerator) -> None:
        super().__init__()
        self.net = net

    def forward(self, latent: Tensor, start: Tensor, goal: Tensor, noise: Tensor) -> Tensor:
        """Points (m, 1, d) rad."""
        points: Tensor = self.net(Condition(latent, start, goal), noise)
        return points.unsqueeze(1)


def point_graph(net: PathGenerator, latent_dim: int) -> PathGraph:
    """The graph of a generator."""
    dim, noise = net.joints.dim, RandomInput("noise", "normal", (net.noise_dim,))
    shapes = {"latent": (latent_dim,), "start": (dim,), "goal": (dim,), "noise": noise.shape}
    rows = tuple(torch.zeros(2, *shape) for shape in shapes.values())
    axes = batched("latents", len(rows))
    model = exported(PointSampler(net).eval(), rows, list(shapes), ["samples"], axes)
    return PathGraph(model, (noise,), looks_at_picture=False)


def trained_bundle(
    folder: Path,
    job: Job[PathTrainConfig],
    outcome: TrialOutcome,
    arrays: PathArrays,
    source: Bundle,
    dataset: Dataset,
) -> Bundle:
    """The bundle of one of a job's trials, which is named after its model."""
    train = job.config
    graph = point_graph(load_points(train.wgan, arrays, outcome.checkpoint), source.spec.latent_dim)
    seeds = {"training": train.seed, "data": dataset.generator_seed}
    recipe = {"path_model": outcome.name, "source_digest": source.digest, **train.to_dict()}
    recipe |= {} if job.start_run_id is None else {TAG_START: job.start_run_id}
    metrics = {**outcome.metrics, "training_s": outcome.seconds}
    return write_path_bundle(folder, source, graph, dataset.digest, seeds, recipe, metrics)
