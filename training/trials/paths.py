"""The trial of the path model: its arrays and its training."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.dataset import Dataset
from cspace.errors import ConfigError
from cspace.world import World
from services.progress import Progress
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


@dataclass(frozen=True, slots=True)
class PathArrays:
    """Paths with what a bundle tells of their pictures."""

    world: World
    paths: NDArray[np.float32]  # (T, P, d) float32 rad, points at equal distances
    ids: NDArray[np.int64]  # (T,) int64 scenario of each
    mu: NDArray[np.float32]  # (S, L) float32
    sigma: NDArray[np.float32]  # (S, L) float32

    def samples(self) -> PathSamples:
        """Tensors for the modules; copied, for the shared arrays are read-only."""
        return PathSamples(*(torch.tensor(part) for part in (self.paths, self.ids, self.mu, self.sigma)))


def require_world(bundle: Bundle, world: World) -> None:
    """See that paths are of the world that a bundle sees."""
    if world != bundle.spec.world:
        raise ConfigError(
            "the paths are of another robot or camera than the bundle",
            expected=str(bundle.spec.world),
            got=str(world),
        )


def path_arrays(bundle: Bundle, dataset: Dataset, points: int) -> PathArrays:
    """Paths and latents of all scenarios."""
    require_world(bundle, dataset.world)
    paths, ids = equal_paths(dataset, points)
    images = dataset.images
    latents = []
    with Progress("pictures", len(images), _LOG.info, "picture") as progress:
        for image in images:
            latents.append(bundle.encode(image))
            progress.advance()
    mu, sigma = (np.stack([getattr(one, name) for one in latents]) for name in ("mu", "sigma"))
    return PathArrays(dataset.world, paths, ids, mu, sigma)


def path_trial(trial: TrialRequest, train: PathTrainConfig, arrays: PathArrays) -> None:
    """Train the path model."""
    with seeded_initialisation(trial.seed):
        module = PathGanModule(train.wgan, arrays.samples(), trial.seed, arrays.world.space)
    fit_tracked(trial, module, train.wgan, train.resources)


def load_points(config: PathGanConfig, arrays: PathArrays, checkpoint: Path) -> PathGenerator:
    """The generator of a trial's checkpoint."""
    sizes = point_sizes(config, arrays.world.space, arrays.mu.shape[1])
    return trained(lambda: PathGenerator(sizes, config.noise_dim), checkpoint, "net")
