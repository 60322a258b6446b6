"""From a trained path model to a bundle that sees with the source's encoder and validity head."""

from collections.abc import Mapping
from pathlib import Path

from cspace.bundle import Bundle
from cspace.dataset import Dataset
from training.config.paths import PathModel, PathTrainConfig
from training.jobs.job import TAG_START
from training.models.lookups.lookups import make_lookups
from training.models.pictures.autoencoders import network_size
from training.paths.export import PointSampler, point_graph
from training.paths.writing import PathGraph, write_path_bundle
from training.trials.paths.arrays import PathArrays
from training.trials.paths.trainables import load_points


def path_graph(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, source: Bundle, checkpoint: Path
) -> PathGraph:
    """The graph of a trial's network."""
    spec = source.spec
    config = train.points_of(name)
    net = load_points(name, train, arrays, checkpoint)
    lookups = make_lookups(config.lookups, spec.world)
    points = PointSampler(net, lookups, place=config.place, sweep=train.sweep, jitter_rad=config.jitter_rad)
    return point_graph(points.eval(), spec.latent_dim, network_size(spec.world.sensor))


def trained_bundle(
    folder: Path,
    name: PathModel,
    train: PathTrainConfig,
    arrays: PathArrays,
    source: Bundle,
    dataset: Dataset,
    checkpoint: Path,
    metrics: Mapping[str, float],
    start_run_id: str | None = None,
) -> Bundle:
    """The bundle of one trial, which started from the weights of the job of ``start_run_id``, if any."""
    graph = path_graph(name, train, arrays, source, checkpoint)
    seeds = {"training": train.seed, "data": dataset.generator_seed}
    recipe = {"path_model": name, "source_digest": source.digest, **train.to_dict()}
    recipe |= {} if start_run_id is None else {TAG_START: start_run_id}
    return write_path_bundle(folder, source, graph, dataset.digest, seeds, recipe, metrics)
