"""The trials of path models: their arrays, the local critics that guide them, and the training."""

import json
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
from training.jobs.environment import RECORD as JOB_RECORD
from training.models.checkpoint import seeded_initialisation, trained
from training.models.lookups import Scenes, make_lookups, make_reader, values_read
from training.models.modules import Metrics, TrialModule
from training.models.networks import Critic
from training.models.paths import (
    FlowModule,
    PathFlow,
    PathGanModule,
    PathGenerator,
    PathSamples,
    equal_paths,
    point_sizes,
)
from training.models.settings import FlowConfig, LookupConfig
from training.trials.fit import fit_tracked
from training.trials.launch import TrialFolder, TrialRequest
from training.trials.trainables import load_critic

_LOG = logging.getLogger("training")
# Pictures of more bytes stay on disk: those of space are a megabyte each.
HELD_BYTES = 2**28


@dataclass(frozen=True, slots=True)
class PathArrays:
    """Paths with what a bundle tells of their pictures.

    Args:
        world: robot and sensor.
        paths: (T, P, d) float32 rad, points at equal distances.
        ids: (T,) int64 scenario of each.
        mu: (S, L) float32.
        sigma: (S, L) float32.
        images: (S, ...) uint8, or the data set's folder, from which every node reads them where they are
            too large to be sent about.
    """

    world: World
    paths: NDArray[np.float32]
    ids: NDArray[np.int64]
    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]
    images: NDArray[np.uint8] | Path

    def samples(self) -> PathSamples:
        """Tensors for the modules; copied, for the shared arrays are read-only."""
        return PathSamples(*(torch.tensor(part) for part in (self.paths, self.ids, self.mu, self.sigma)))

    def scenes(self) -> Scenes:
        """The pictures for look-ups, copied, or mapped from the disk."""
        if isinstance(self.images, Path):
            # Mapped as its own, for torch warns of what cannot be written.
            mapped = np.load(self.images / "images.npy", mmap_mode="c")
            return Scenes(self.world, torch.from_numpy(mapped))
        return Scenes(self.world, torch.tensor(self.images))


def require_world(bundle: Bundle, world: World) -> None:
    """See that paths are of the world that a bundle sees.

    Raises:
        ConfigError: the robot, the camera or the scenes are others.
    """
    if world != bundle.spec.world:
        raise ConfigError(
            "the paths are of another robot or camera than the bundle",
            expected=str(bundle.spec.world),
            got=str(world),
        )


def path_arrays(bundle: Bundle, dataset: Dataset, points: int) -> PathArrays:
    """Paths and latents of all scenarios.

    Args:
        bundle: that sees the pictures.
        dataset: with paths.
        points: of each path.

    Raises:
        ConfigError: the data set is of another robot or camera than the bundle.
        DatasetError: the data set holds no paths.
    """
    require_world(bundle, dataset.world)
    paths, ids = equal_paths(dataset, points)
    images = dataset.images
    latents = []
    with Progress("pictures", len(images), _LOG.info, "picture") as progress:
        for image in images:
            latents.append(bundle.encode(image))
            progress.advance()
    mu, sigma = (np.stack([getattr(one, name) for one in latents]) for name in ("mu", "sigma"))
    held = dataset.folder.absolute() if images.nbytes > HELD_BYTES else np.asarray(images)
    return PathArrays(dataset.world, paths, ids, mu, sigma, held)


@dataclass(frozen=True, slots=True)
class Guides:
    """Where the local critics are.

    Args:
        train: the job's configuration.
        bundle: the job's bundle.
        checkpoints: of its local trials.
    """

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
    """The local critics of a job.

    Args:
        folder: of the job, with its ``job.json``, ``local`` and ``bundle``.
        digest: of the bundle whose latents the path models see.

    Raises:
        ConfigError: the folder is no finished job with local critics that see latents, or its encoder is
            another.
    """
    try:
        train = TrainConfig.model_validate(
            json.loads((folder / JOB_RECORD).read_text(encoding="utf-8"))["config"]
        )
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(
            "guides is no job's folder", expected=f"a folder with {JOB_RECORD}", got=str(error)
        ) from error
    latest = (TrialFolder(trial).latest() for trial in sorted(folder.glob("local/*")))
    checkpoints = tuple(checkpoint for checkpoint in latest if checkpoint is not None)
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
    tracking_uri: str,
) -> Metrics | None:
    """Train the path model that the trial is named after."""
    name = cast("PathModel", trial.name)
    with seeded_initialisation(trial.seed):
        module = make_path_module(name, train, arrays, trial.seed, guides)
    return fit_tracked(trial, module, train.points_of(name), train.resources, tracking_uri)


def make_path_module(
    name: PathModel,
    train: PathTrainConfig,
    arrays: PathArrays,
    seed: int,
    guides: Guides | None = None,
) -> TrialModule:
    """A path model with its data, ready to be trained.

    Args:
        name: of the model.
        train: sizes and budgets.
        arrays: the data.
        seed: of every draw.
        guides: local critics, for the guided model.

    Raises:
        JobError: there are no guides for a guided model.
    """
    samples, space, config = arrays.samples(), arrays.world.space, train.points_of(name)
    scenes = arrays.scenes() if config.lookups.wanted else None
    if isinstance(config, FlowConfig):
        return FlowModule(config, samples, scenes, seed, space)
    if config.guide_weight == 0.0:
        return PathGanModule(config, samples, scenes, seed, space)
    if guides is None:
        raise JobError("a guided model needs local critics", expected="guides", got="none")
    reader = make_reader(guides.lookups, arrays.scenes())
    return PathGanModule(config, samples, scenes, seed, space, guides.critics(), reader)


def load_points(
    name: PathModel, train: PathTrainConfig, arrays: PathArrays, checkpoint: Path
) -> PathFlow | PathGenerator:
    """The flow or generator of a trial's checkpoint."""
    config = train.points_of(name)
    looked_up = values_read(make_lookups(config.lookups, arrays.world))
    sizes = point_sizes(config, arrays.world.space, arrays.mu.shape[1], looked_up)

    def fresh() -> PathFlow | PathGenerator:
        if isinstance(config, FlowConfig):
            return PathFlow(sizes, config.evaluations, place=config.place)
        return PathGenerator(sizes, config.noise_dim, place=config.place)

    return trained(fresh, checkpoint, "net")
