"""From trained weights to a bundle."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from cspace.bundle import Bundle, BundleSpec, write_bundle
from cspace.bundle.spec import Standardisation
from cspace.dataset import Dataset
from cspace.files import discard
from cspace.world import World
from training.clusters.calibration import (
    choose_bounded,
    choose_threshold,
    collision_bound,
    fit_plan_calibration,
    known_quantiles,
    planned,
    validation_scores,
)
from training.config import HeadConfig, TrainConfig
from training.jobs.provenance import provenance
from training.models.autoencoders import load_encoder, load_scores, network_size
from training.models.checkpoint import load_scene_model, load_weights, trained
from training.models.data import TrainingArrays
from training.models.export import (
    encoder_graph,
    generator_graph,
    novelty_graph,
)
from training.models.families import family
from training.models.field import shipped_field
from training.models.grid_head import GridHead, counts_of
from training.models.grid_training import grid_validity_graph, map_graph
from training.models.validity import make_head, validity_graph

_LOG = logging.getLogger("training")
THRESHOLD_SCENARIOS = 40
# Where the truth of further scenarios is not known, as with data of one's own.
FALLBACK_THRESHOLD = 0.8


@dataclass(frozen=True, slots=True)
class TrainedParts:
    """What the trials left: folders of checkpoints, and the arrays they were trained on."""

    encoder: Path  # the VAE's, or the generator's own where the two were trained together
    done: Mapping[str, Path]  # the family's trials
    validity: Path | None
    arrays: TrainingArrays


def make_bundle(folder: Path, config: TrainConfig, dataset: Dataset, parts: TrainedParts) -> Bundle:
    """Export the networks, write the bundle, and load it again as any reader would."""
    latent_dim, kind = config.vae.latent_dim, family(config.clusters.form)
    sampler = kind(config, parts.arrays).sampler(parts.done)
    sensor, has_head = dataset.world.sensor, parts.validity is not None
    encoder = load_encoder(config.vae, sensor, parts.encoder)
    graphs = {
        "encoder": encoder_graph(encoder, network_size(sensor)),
        "generator": generator_graph(sampler, latent_dim, sensor.pixels),
    }
    if parts.validity is not None:
        graphs |= head_graphs(config.validity, dataset.world, parts.validity)
    known = None
    # The paper's joint baseline stays as the paper has it.
    if not config.trains_encoder:
        scores = load_scores(config.vae, sensor, parts.encoder)
        known = known_quantiles(config.vae, parts.encoder, scores, dataset)
        graphs["novelty"] = novelty_graph(scores, network_size(sensor), latent_dim)
    scale = sampler.scale and Standardisation(*(tuple(map(float, part)) for part in sampler.scale))
    spec = BundleSpec(
        world=dataset.world,
        latent_dim=latent_dim,
        model_kind=kind.model_kind,
        looks_at_picture=sampler.looks_at_picture,
        samples_per_latent=sampler.samples_per_latent,
        random_inputs=sampler.random_inputs,
        confidence_threshold=(config.validity.threshold or FALLBACK_THRESHOLD) if has_head else None,
        novelty_quantiles=known,
        standardisation=scale,
        provenance=provenance(
            config.to_dict(),
            data_digest=dataset.digest,
            seeds={"train": config.seed, "data": config.data.seed},
        ),
    )
    if has_head and dataset.generator_seed is not None:
        spec = with_choices(folder.with_name(folder.name + "-draft"), config.validity, spec, graphs)
    return Bundle.load(write_bundle(folder, spec, graphs))


def head_graphs(config: HeadConfig, world: World, checkpoint: Path) -> dict[str, bytes]:
    """The graphs of a validity head: a trained one's, or for any arm those of a scene model."""
    if config.grid is None:
        flat = trained(lambda: make_head(config, world), checkpoint, "head")
        return {"validity": validity_graph(flat, world.sensor.pixels, world.dim)}
    file = config.scene_model_file
    if file is None:
        head = trained(lambda: GridHead.of(config, world), checkpoint, "head")
    else:
        model = load_scene_model(file, world)
        if checkpoint != file:
            model.load_state_dict(load_weights(checkpoint, "head.model"))
        head = GridHead(model, world.grid_arm(model.config.groups), counts_of(world)).eval()
    return {
        "map": map_graph(head),
        "validity": grid_validity_graph(head, world.dim),
        "field": shipped_field(world),
    }


def with_choices(
    folder: Path, config: HeadConfig, spec: BundleSpec, graphs: Mapping[str, bytes]
) -> BundleSpec:
    """By the rules of ``threshold`` and ``promise``, from a draft of the bundle that is deleted again."""
    chosen = config.threshold is not None and config.promise is None
    if chosen and not config.plan_problems:
        return spec
    # What an attempt left that was killed here.
    discard(folder)
    try:
        draft = Bundle.load(write_bundle(folder, spec, graphs))
        fitted = spec if chosen else _with_threshold(draft, config, spec)
        if not config.plan_problems:
            return fitted
        _LOG.info("plans: %d problems", config.plan_problems)
        found = fit_plan_calibration(planned(draft, spec.world, config.plan_problems))
        return fitted if found is None else found.stated_in(fitted)
    finally:
        discard(folder)


def _with_threshold(draft: Bundle, config: HeadConfig, spec: BundleSpec) -> BundleSpec:
    threshold, bound = config.threshold, config.promise
    scenarios = THRESHOLD_SCENARIOS if bound is None else bound.scenarios
    proposed, uniform = validation_scores(draft, spec.world, scenarios)
    if threshold is None and bound is not None:
        threshold = choose_bounded(proposed, bound.at_most)
    elif threshold is None:
        threshold = choose_threshold(proposed, config.target_precision)
    if bound is not None:
        kinds = {"samples": proposed, "uniform": uniform}
        metrics = {
            f"promise/{kind}_collide/{name}": value
            for kind, scenes in kinds.items()
            for name, value in collision_bound(scenes, threshold).items()
        }
        spec = replace(spec, provenance=replace(spec.provenance, metrics=metrics))
    return replace(spec, confidence_threshold=threshold)
