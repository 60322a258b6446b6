"""The trials of path models: their arrays, the local critics that guide them, and the training."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.dataset import Dataset
from cspace.errors import ConfigError, JobError
from cspace.world import World
from services.progress import Progress
from training.config import PathModel, PathTrainConfig, TrainConfig
from training.jobs.job import CONFIGURATION
from training.models.checkpoint import seeded_initialisation, trained
from training.models.lookups import Scenes, make_reader
from training.models.networks import Critic
from training.models.paths import (
    PathGanModule,
    PathGenerator,
    PathSamples,
    equal_paths,
    point_sizes,
)
from training.models.settings import LookupConfig
from training.trials.fit import fit_tracked
from training.trials.launch import FINAL, TrialRequest
from training.trials.trainables import load_critic

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


@dataclass(frozen=True, slots=True)
class Guides:
    """Where the local critics are."""

    train: TrainConfig
    bundle: Path
    checkpoints: tuple[Path, ...]

    @property
    def lookups(self) -> LookupConfig:
        """Where the critics read the picture."""
        return self.train.local.critic_lookups

    def critics(self) -> list[Critic]:
        """The critics, as they were trained."""
        spec = Bundle.load(self.bundle).spec
        return [
            load_critic(self.train.local, spec.world, spec.latent_dim, 0, checkpoint)
            for checkpoint in self.checkpoints
        ]


def find_guides(folder: Path, digest: str) -> Guides:
    """The local critics of a job."""
    try:
        train = TrainConfig.model_validate_json((folder / CONFIGURATION).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(
            "guides is no job's folder", expected=f"a folder with {CONFIGURATION}", got=str(error)
        ) from error
    checkpoints = tuple(sorted(folder.glob(f"local/*/{FINAL}")))
    if not checkpoints or train.local.critic_condition != "latent":
        raise ConfigError(
            "the job has no local critics that can guide",
            expected="local trials with critic_condition=latent",
            got=f"{len(checkpoints)} local checkpoints, critic_condition={train.local.critic_condition}",
        )
    if Bundle.load(folder / "bundle").digest != digest:
        raise ConfigError(
            "the guides see other latents than the path models",
            expected="source and guides of one job",
            got=f"{digest[:12]} and {folder}",
            remedy=f"set source={folder / 'bundle'}",
        )
    return Guides(train, folder / "bundle", checkpoints)


def path_trial(
    trial: TrialRequest,
    train: PathTrainConfig,
    arrays: PathArrays,
    guides: Guides | None,
    images: NDArray[np.uint8] | None,
) -> None:
    """Train the path model that the trial is named after."""
    name = cast("PathModel", trial.name)
    with seeded_initialisation(trial.seed):
        module = make_path_module(name, train, arrays, trial.seed, guides, images)
    fit_tracked(trial, module, train.points_of(name), train.resources)


def make_path_module(
    name: PathModel,
    train: PathTrainConfig,
    arrays: PathArrays,
    seed: int,
    guides: Guides | None = None,
    images: NDArray[np.uint8] | None = None,
) -> PathGanModule:
    """A path model with its data, ready to be trained.

    ``images`` (S, P, P, 3) uint8, where these read pictures.
    """
    samples, space, config = arrays.samples(), arrays.world.space, train.points_of(name)
    if config.guide_weight == 0.0:
        return PathGanModule(config, samples, seed, space)
    if guides is None:
        raise JobError("a guided model needs local critics", expected="guides", got="none")
    scenes = None if images is None else Scenes(arrays.world, torch.tensor(images))
    reader = make_reader(guides.lookups, scenes)
    return PathGanModule(config, samples, seed, space, guides.critics(), reader)


def load_points(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, checkpoint: Path
) -> PathGenerator:
    """The generator of a trial's checkpoint."""
    config = train.points_of(name)
    sizes = point_sizes(config, arrays.world.space, arrays.mu.shape[1])
    return trained(lambda: PathGenerator(sizes, config.noise_dim), checkpoint, "net")
