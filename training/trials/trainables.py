"""The trials of VAE, validity head, gate and WGAN-GPs, and how networks are loaded."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.errors import JobError
from cspace.world import World
from training.config import TrainConfig
from training.models.autoencoders import shown
from training.models.checkpoint import seeded_initialisation, trained
from training.models.joint import JointModule
from training.models.lookups import make_lookups, values_read
from training.models.mixture import Experts, Gate, GatedSampler, GateModule
from training.models.modules import TrialModule, VaeModule, WganGpModule, make_critic, make_generator
from training.models.networks import Critic, MeansGenerator, TorusGenerator
from training.models.settings import GanConfig, LookupConfig, TrialSettings
from training.trials.arrays import TrainingArrays, head_module
from training.trials.fit import fit_tracked
from training.trials.launch import TrialRequest


def make_wgan(
    config: GanConfig,
    arrays: TrainingArrays,
    cluster: int | None,
    seed: int,
    critics: list[Critic] | None = None,
    weight: float = 0.0,
) -> WganGpModule:
    """A WGAN-GP on the configurations of one cluster, or on all, that starts where the cells say."""
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
    """The whole sampler behind a gate: one generator for all cells, or one for each cluster of them."""
    if arrays.cells is None:
        raise JobError("a gated sampler needs its cells", expected="gate.cells above 0", got="none")
    clusters = torch.tensor(arrays.cells.clusters)
    parts = [torus_generator(generator) for generator in generators]
    experts = Experts(parts, clusters if len(parts) > 1 else torch.zeros_like(clusters))
    return GatedSampler(gate, arrays.cells.points, experts, make_lookups(lookups, arrays.world)).eval()


def load_generator(
    config: GanConfig, arrays: TrainingArrays, checkpoint: Path
) -> TorusGenerator | MeansGenerator:
    """The generator of a trial's checkpoint."""
    looked_up, space = values_read(make_lookups(config.generator_lookups, arrays.world)), arrays.world.space
    latent_dim = arrays.mu.shape[1]
    return trained(
        lambda: make_generator(config, space, latent_dim, arrays.scale, looked_up), checkpoint, "generator"
    )


def torus_generator(generator: TorusGenerator | MeansGenerator) -> TorusGenerator:
    """The same, where only a torus generator will do."""
    if not isinstance(generator, TorusGenerator):
        raise JobError("a gate needs torus generators", expected="generator=torus", got="generator=means")
    return generator


def load_critic(config: GanConfig, world: World, latent_dim: int, scenarios: int, checkpoint: Path) -> Critic:
    """The critic of a trial's checkpoint; ``scenarios`` as of :func:`make_critic`."""
    looked_up = values_read(make_lookups(config.critic_lookups, world))
    # The angles' mean and deviation are among the weights.
    scale = torch.zeros(world.dim), torch.ones(world.dim)
    return trained(
        lambda: make_critic(config, world.space, latent_dim, scenarios, scale, looked_up),
        checkpoint,
        "critic",
    )


def load_gate(config: TrainConfig, checkpoint: Path) -> Gate:
    """The gate of a trial's checkpoint."""
    sizes = (config.vae.latent_dim, config.gate.hidden, config.gate.layers, config.gate.cells)
    return trained(lambda: Gate(*sizes), checkpoint, "gate")


VAE, VALIDITY, GATE, GLOBAL = "vae", "validity", "gate", "global"


def picture_trial(
    trial: TrialRequest,
    train: TrainConfig,
    images: NDArray[np.uint8],
    data_folder: Path,
) -> None:
    """Train what learns from pictures, channels first, and needs no latents: the VAE, or the head."""
    pictures = torch.tensor(images)
    module: TrialModule
    settings: TrialSettings
    with seeded_initialisation(trial.seed):
        if trial.name == VALIDITY:
            module = head_module(data_folder, train.validity, pictures, trial.seed, train.data.outcomes)
            settings = train.validity
        else:
            module, settings = VaeModule(train.vae, pictures, trial.seed), train.vae
    fit_tracked(trial, module, settings, train.resources, pictures=len(images))


def gate_trial(trial: TrialRequest, train: TrainConfig, arrays: TrainingArrays) -> None:
    """Train the gate on the cells' shares of every scenario's free configurations."""
    mu, sigma = torch.tensor(arrays.mu), torch.tensor(arrays.sigma)
    with seeded_initialisation(trial.seed):
        module = GateModule(train.gate, mu, sigma, arrays.shares(), trial.seed)
    fit_tracked(trial, module, train.gate, train.resources)


def local_trial(trial: TrialRequest, train: TrainConfig, arrays: TrainingArrays) -> None:
    """Train one cluster's WGAN-GP (Algorithm 1)."""
    module = make_wgan(train.local, arrays, trial.cluster, trial.seed)
    part = arrays.part(trial.cluster)
    fit_tracked(trial, module, train.local, train.resources, **part)


def global_trial(
    trial: TrialRequest,
    train: TrainConfig,
    arrays: TrainingArrays,
    local_checkpoints: list[Path],
) -> None:
    """Train the global WGAN-GP on all data, guided by the frozen local critics (eq. multiDirector)."""
    scenarios, latent_dim = arrays.mu.shape
    critics = [
        load_critic(train.local, arrays.world, latent_dim, scenarios, path) for path in local_checkpoints
    ]
    weight = train.global_.local_critic_weight
    module = make_wgan(train.global_, arrays, None, trial.seed, critics, weight)
    fit_tracked(trial, module, train.global_, train.resources)


def joint_trial(
    trial: TrialRequest,
    train: TrainConfig,
    arrays: TrainingArrays,
    images: NDArray[np.uint8],
) -> None:
    """Train one WGAN-GP on all data together with the encoder of (S, P, P, 3) pictures."""
    with seeded_initialisation(trial.seed):
        module = JointModule(
            train.global_,
            train.vae,
            arrays.samples(None),
            torch.tensor(shown(arrays.world.sensor, images)),
            arrays.scale,
            trial.seed,
            arrays.world.space,
        )
    fit_tracked(trial, module, train.global_, train.resources)
