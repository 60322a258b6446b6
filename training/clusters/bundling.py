"""From trained weights to a bundle."""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from cspace.bundle import Bundle, BundleSpec, RandomInput, write_bundle
from cspace.dataset import Dataset
from cspace.files import discard
from cspace.space import Standardisation
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
from training.jobs.job import TAG_START
from training.jobs.provenance import provenance
from training.models.autoencoders import network_size
from training.models.belief import belief_graph
from training.models.checkpoint import load_scene_model, load_weights, trained
from training.models.export import (
    encoder_graph,
    generator_graph,
    novelty_graph,
    validity_graph,
)
from training.models.grid_head import GridHead, counts_of
from training.models.grid_training import grid_validity_graph, map_graph
from training.models.lookups import make_lookups
from training.models.mixture import LookupSampler
from training.models.settings import GanConfig
from training.models.validity import make_head
from training.trials.arrays import TrainingArrays, load_encoder, load_scores
from training.trials.trainables import gated_sampler, load_gate, load_generator, torus_generator

_LOG = logging.getLogger("training")
THRESHOLD_SCENARIOS = 40
# Where the truth of further scenarios is not known, as with data of one's own.
FALLBACK_THRESHOLD = 0.8


@dataclass(frozen=True, slots=True)
class TrainedParts:
    """What the trials left: folders of checkpoints, and the arrays they were trained on."""

    encoder: Path  # the VAE's, or the generator's own where the two were trained together
    generators: tuple[Path, ...]
    gate: Path | None
    validity: Path | None
    arrays: TrainingArrays
    start_run_id: str | None = None


def make_bundle(folder: Path, config: TrainConfig, dataset: Dataset, parts: TrainedParts) -> Bundle:
    """Export the networks, write the bundle, and load it again as any reader would."""
    gan, latent_dim, dim = generator_config(config), config.vae.latent_dim, dataset.dim
    sensor, has_head = dataset.world.sensor, parts.validity is not None
    encoder = load_encoder(config.vae, sensor, parts.encoder)
    graphs = {
        "encoder": encoder_graph(encoder, network_size(sensor)),
        "generator": _sampler_graph(config, parts),
    }
    if parts.validity is not None:
        graphs |= head_graphs(config.validity, dataset.world, parts.validity)
    known = None
    # The paper's joint baseline stays as the paper has it.
    if not config.joint:
        scores = load_scores(config.vae, sensor, parts.encoder)
        known = known_quantiles(config.vae, parts.encoder, scores, dataset)
        graphs["novelty"] = novelty_graph(scores, network_size(sensor), latent_dim)
    scale = Standardisation(*(tuple(float(v) for v in part) for part in parts.arrays.scale))
    spec = BundleSpec(
        world=dataset.world,
        latent_dim=latent_dim,
        model_kind="generator" if parts.gate is None else "mixture",
        looks_at_picture=gan.generator_lookups.points_per_link > 0,
        samples_per_latent=gan.means,
        random_inputs=random_inputs(gan, dim, gated=parts.gate is not None),
        confidence_threshold=(config.validity.threshold or FALLBACK_THRESHOLD) if has_head else None,
        novelty_quantiles=known,
        standardisation=scale if gan.generator == "means" else None,
        provenance=provenance(
            config.to_dict() | ({TAG_START: parts.start_run_id} if parts.start_run_id else {}),
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
        "belief": belief_graph(head.model, world),
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
        metrics = [collision_bound(scenes, threshold).metrics(kind) for kind, scenes in kinds.items()]
        spec = replace(spec, provenance=replace(spec.provenance, metrics=metrics[0] | metrics[1]))
    return replace(spec, confidence_threshold=threshold)


def generator_config(config: TrainConfig) -> GanConfig:
    """The shape of the generators that a bundle holds: local ones in a mixture, else the global one."""
    return config.local if config.clusters.form == "mixture" else config.global_


def random_inputs(gan: GanConfig, dim: int, *, gated: bool) -> tuple[RandomInput, ...]:
    """The random inputs of a generator's graph, in the order in which they are drawn."""
    if gan.generator == "means":
        return (RandomInput("noise", "normal", (gan.means, dim)),)
    noise = RandomInput("noise", "normal", (gan.noise_dim,))
    if not gated:
        return (RandomInput("base", "uniform", (dim,), -math.pi, math.pi), noise)
    return (
        RandomInput("cell", "uniform", (1,), 0.0, 1.0),
        RandomInput("place", "uniform", (1,), 0.0, 1.0),
        RandomInput("jitter", "uniform", (dim,), -0.5, 0.5),
        noise,
    )


def _sampler_graph(config: TrainConfig, parts: TrainedParts) -> bytes:
    gan, arrays = generator_config(config), parts.arrays
    latent_dim, pixels = config.vae.latent_dim, arrays.world.sensor.pixels
    generators = [load_generator(gan, arrays, folder) for folder in parts.generators]
    if parts.gate is not None:
        gate = load_gate(config, parts.gate)
        mixture = gated_sampler(gate, arrays, generators, gan.generator_lookups)
        return generator_graph(mixture, latent_dim, pixels)
    lookups = make_lookups(gan.generator_lookups, arrays.world)
    if lookups is not None:
        looking = LookupSampler(torus_generator(generators[0]), lookups)
        return generator_graph(looking, latent_dim, pixels)
    return generator_graph(generators[0], latent_dim)
