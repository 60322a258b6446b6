"""Networks of the configuration space, fresh or from a trial's checkpoint."""

from collections.abc import Sequence
from pathlib import Path

import torch

from cspace.errors import JobError
from training.config.clusters import TrainConfig
from training.models.checkpoint import seeded_initialisation, trained
from training.models.gate import Gate
from training.models.lookups.lookups import make_lookups, values_read
from training.models.mixture import Experts, GatedSampler
from training.models.modules import WganGpModule, make_critic, make_generator
from training.models.networks import Critic, MeansGenerator, TorusGenerator
from training.models.settings import GanConfig, LookupConfig
from training.trials.arrays import TrainingArrays


def make_wgan(
    config: GanConfig,
    arrays: TrainingArrays,
    cluster: int | None,
    seed: int,
    critics: list[Critic] | None = None,
    weight: float = 0.0,
) -> WganGpModule:
    """A WGAN-GP on the configurations of one cluster, or on all, that starts where the cells say.

    Args:
        config: its settings.
        arrays: the data.
        cluster: which; None for all.
        seed: of initialisation and of every draw.
        critics: frozen local critics that guide it.
        weight: of their mean.
    """
    with seeded_initialisation(seed):
        return WganGpModule(
            config,
            arrays.samples(cluster),
            arrays.scale,
            seed,
            arrays.world.space,
            critics,
            weight,
            base=arrays.base(cluster),
            scenes=arrays.scenes(),
        )


def gated_sampler(
    gate: Gate,
    arrays: TrainingArrays,
    generators: Sequence[TorusGenerator | MeansGenerator],
    lookups: LookupConfig,
) -> GatedSampler:
    """The whole sampler behind a gate: one generator for all cells, or one for each cluster of them.

    Raises:
        JobError: there are no cells, or generators that do not start in cells.
    """
    if arrays.cells is None:
        raise JobError("a gated sampler needs its cells", expected="gate.cells above 0", got="none")
    clusters = torch.tensor(arrays.cells.clusters)
    parts = [torus_generator(generator) for generator in generators]
    experts = Experts(parts, clusters if len(parts) > 1 else torch.zeros_like(clusters))
    return GatedSampler(gate, arrays.cells.points, experts, make_lookups(lookups, arrays.world)).eval()


def fresh_generator(config: GanConfig, arrays: TrainingArrays) -> TorusGenerator | MeansGenerator:
    """A generator of the shape that fits the data, not trained."""
    looked_up = values_read(make_lookups(config.generator_lookups, arrays.world))
    return make_generator(config, arrays.world.space, arrays.mu.shape[1], arrays.scale, looked_up)


def load_generator(
    config: GanConfig, arrays: TrainingArrays, checkpoint: Path
) -> TorusGenerator | MeansGenerator:
    """The generator of a trial's checkpoint."""
    return trained(lambda: fresh_generator(config, arrays), checkpoint, "generator")


def torus_generator(generator: TorusGenerator | MeansGenerator) -> TorusGenerator:
    """The same, where only a torus generator will do.

    Raises:
        JobError: it is of the other kind.
    """
    if not isinstance(generator, TorusGenerator):
        raise JobError("a gate needs torus generators", expected="generator=torus", got="generator=means")
    return generator


def load_critic(config: GanConfig, arrays: TrainingArrays, checkpoint: Path) -> Critic:
    """The critic of a trial's checkpoint."""
    looked_up, space = values_read(make_lookups(config.critic_lookups, arrays.world)), arrays.world.space
    scenarios, latent_dim = arrays.mu.shape
    return trained(
        lambda: make_critic(config, space, latent_dim, scenarios, arrays.scale, looked_up),
        checkpoint,
        "critic",
    )


def load_gate(config: TrainConfig, checkpoint: Path) -> Gate:
    """The gate of a trial's checkpoint."""
    sizes = (config.vae.latent_dim, config.gate.hidden, config.gate.layers, config.gate.cells)
    return trained(lambda: Gate(*sizes), checkpoint, "gate")
