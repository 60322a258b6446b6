"""The trial of the path model: its samples and its training."""

import logging
from pathlib import Path

import numpy as np
import torch

from cspace.bundle import Bundle, BundleSpec
from cspace.dataset import Dataset
from cspace.errors import ConfigError
from cspace.space import JointSpace
from cspace.world import World
from services.commands import Progress
from training.config import PathGanConfig, PathTrainConfig
from training.models.checkpoint import seeded_initialisation, trained
from training.models.paths import (
    PathGanModule,
    PathGenerator,
    PathSamples,
    equal_paths,
    point_sizes,
)
from training.trials.fit import fit_tracked
from training.trials.launch import TrialRequest

_LOG = logging.getLogger("training")


def require_world(bundle: Bundle, world: World) -> None:
    """See that paths are of the world that a bundle sees."""
    if world != bundle.spec.world:
        raise ConfigError(
            "the paths are of another robot or camera than the bundle",
            expected=str(bundle.spec.world),
            got=str(world),
        )


def path_samples(bundle: Bundle, dataset: Dataset, points: int) -> PathSamples:
    """Paths, and the latents of all scenarios that a bundle's encoder tells."""
    require_world(bundle, dataset.world)
    paths, ids = equal_paths(dataset, points)
    latents = []
    with Progress("pictures", len(dataset.images), _LOG.info, "picture") as progress:
        for image in dataset.images:
            latents.append(bundle.encode(image))
            progress.advance()
    mu, sigma = (np.stack([getattr(one, name) for one in latents]) for name in ("mu", "sigma"))
    return PathSamples(*(torch.tensor(part) for part in (paths, ids, mu, sigma)))


def path_trial(trial: TrialRequest, train: PathTrainConfig, samples: PathSamples, space: JointSpace) -> None:
    """Train the path model."""
    with seeded_initialisation(trial.seed):
        module = PathGanModule(train.wgan, samples, trial.seed, space)
    fit_tracked(trial, module, train.wgan, train.resources)


def load_points(config: PathGanConfig, spec: BundleSpec, checkpoint: Path) -> PathGenerator:
    """The generator of a trial's checkpoint, which sees as a bundle does."""
    sizes = point_sizes(config, spec.world.space, spec.latent_dim)
    return trained(lambda: PathGenerator(sizes, config.noise_dim), checkpoint, "net")
