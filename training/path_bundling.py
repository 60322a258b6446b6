"""From a trained path model to a bundle that sees with the source's encoder and validity head."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cspace.bundle import Bundle, Provenance, write_bundle
from cspace.bundle.files import ENCODER_FILE, NOVELTY_FILE, VALIDITY_FILE
from cspace.dataset import Dataset
from training.models.lookups import make_lookups
from training.models.path_density import DensitySampler
from training.models.path_export import PathGraph, PointSampler, density_graph, point_graph
from training.path_config import PathModel, PathTrainConfig, PointConfig
from training.provenance import command_line, now, source_state
from training.trials.path_arrays import PathArrays
from training.trials.path_trials import load_density, load_points


def path_graph(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, source: Bundle, checkpoint: Path
) -> PathGraph:
    """The graph of a trial's network."""
    spec = source.spec
    if name == "density":
        sampler = DensitySampler(load_density(train, arrays, checkpoint), train.density, train.sweep)
        head = (source.folder / VALIDITY_FILE).read_bytes()
        return density_graph(sampler.eval(), head, spec.robot.space, spec.latent_dim)
    config: PointConfig = getattr(train, name)
    net = load_points(name, train, arrays, checkpoint)
    lookups = make_lookups(config.lookups, spec.robot, spec.camera)
    points = PointSampler(net, lookups, place=config.place, sweep=train.sweep, jitter_rad=config.jitter_rad)
    return point_graph(points.eval(), spec.latent_dim, spec.camera.pixels)


def write_path_bundle(
    folder: Path,
    source: Bundle,
    graph: PathGraph,
    data_digest: str | None,
    seeds: Mapping[str, Any],
    recipe: Mapping[str, Any],
    metrics: Mapping[str, Any] | None = None,
) -> Bundle:
    """Write a path sampler that encodes, scores and knows novelty as another bundle does, and load it again.

    Args:
        folder: must not exist.
        source: whose encoder, head and novelty it takes.
        graph: of the sampler.
        data_digest: of what it was trained on.
        seeds: by stage.
        recipe: how it was made; plain values.
        metrics: what was measured; plain values.

    Raises:
        BundleError: the parts do not make a bundle.
        StorageError: the folder exists or cannot be written.
    """
    graphs = {"encoder": (source.folder / ENCODER_FILE).read_bytes(), "generator": graph.model}
    if source.has_validity:
        graphs["validity"] = (source.folder / VALIDITY_FILE).read_bytes()
    if source.spec.novelty_quantiles is not None:
        graphs["novelty"] = (source.folder / NOVELTY_FILE).read_bytes()
    state = source_state()
    spec = replace(
        source.spec,
        kind="path",
        model_kind="generator",
        looks_at_picture=graph.looks_at_picture,
        samples_per_latent=1,
        random_inputs=graph.random_inputs,
        standardisation=None,
        # A planner drops what collides by itself, and a passage that the head closes keeps its samples.
        confidence_threshold=0.0 if source.has_validity else None,
        uniform_share=0.0,
        provenance=Provenance(
            git_commit=state.commit,
            git_dirty=state.dirty,
            data_digest=data_digest,
            seeds=seeds,
            config=recipe,
            metrics=metrics or {},
            created=now(),
            command=command_line(),
        ),
    )
    return Bundle.load(write_bundle(folder, spec, graphs))


def trained_bundle(
    folder: Path,
    name: PathModel,
    train: PathTrainConfig,
    arrays: PathArrays,
    source: Bundle,
    dataset: Dataset,
    checkpoint: Path,
    metrics: Mapping[str, float],
) -> Bundle:
    """The bundle of one trial."""
    graph = path_graph(name, train, arrays, source, checkpoint)
    seeds = {"training": train.seed, "data": dataset.generator_seed}
    recipe = {"path_model": name, "source_digest": source.digest, **train.to_dict()}
    return write_path_bundle(folder, source, graph, dataset.digest, seeds, recipe, metrics)
