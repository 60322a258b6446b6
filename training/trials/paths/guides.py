"""Local critics of the configuration space that guide a path model: those of an earlier cluster-train job."""

import json
from dataclasses import dataclass
from pathlib import Path

import torch

from cspace.bundle import Bundle
from cspace.errors import ConfigError
from training.config.clusters import TrainConfig
from training.jobs.folders import RECORD as JOB_RECORD
from training.models.checkpoint import trained
from training.models.lookups.lookups import make_lookups, values_read
from training.models.modules import make_critic
from training.models.networks import Critic
from training.models.settings import LookupConfig
from training.trials.checkpoints import TrialFolder


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
        looked_up = values_read(make_lookups(self.lookups, spec.world))
        # The angles' mean and deviation are among the weights.
        scale = (torch.zeros(spec.dim), torch.ones(spec.dim))

        def fresh() -> Critic:
            return make_critic(self.train.local, spec.world.space, spec.latent_dim, 0, scale, looked_up)

        return [trained(fresh, checkpoint, "critic") for checkpoint in self.checkpoints]


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
