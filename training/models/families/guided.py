"""The paper's model: a WGAN-GP a cluster, whose critics guide a global generator (eq. multiDirector)."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from pydantic import Field
from torch import Tensor, nn

from training.config import TrainConfig
from training.models.data import Batch
from training.models.families import Checkpoints, Trial, register
from training.models.families.wgan_gp import (
    GLOBAL,
    Critic,
    GanConfig,
    WganGp,
    WganGpModule,
)


class GlobalConfig(GanConfig):
    """The global WGAN-GP, guided by the local critics."""

    local_critic_weight: float = Field(0.1, ge=0, description="weight of the local critics' mean; 0 is off")


class GuidedConfig(TrainConfig):
    """Everything that fixes a job whose local critics guide a global generator."""

    local: GanConfig = GanConfig(steps=400)
    global_: GlobalConfig = Field(GlobalConfig(), alias="global")


class GuidedModule(WganGpModule):
    """A WGAN-GP whose generator minimises its own critic's loss and the mean of frozen local ones'."""

    def __init__(self, config: GlobalConfig, *given: Any, critics: Sequence[Critic] = ()) -> None:
        super().__init__(config, *given)
        self.local_weight = config.local_critic_weight
        self.local_critics = nn.ModuleList(critics).requires_grad_(requires_grad=False)

    def generator_loss(self, fake: Tensor, batch: Batch) -> Tensor:
        """-f(fake) - w * mean over clusters of f_i(fake) (eq. multiDirector)."""
        loss = super().generator_loss(fake, batch)
        if not len(self.local_critics) or self.local_weight == 0.0:
            return loss
        local = torch.stack([-self.values(critic, fake, batch).mean() for critic in self.local_critics])
        return loss + self.local_weight * local.mean()


def local_names(count: int) -> list[str]:
    """Names of the trials of so many clusters."""
    return [f"local-{index}" for index in range(count)]


@register("guided")
class Guided(WganGp):
    """A WGAN-GP a cluster, then the global one."""

    configuration = GuidedConfig

    def stages(self) -> Mapping[str, Sequence[str]]:
        """The clusters, side by side, before the global generator."""
        return {"local": local_names(self.config.clusters.count), GLOBAL: [GLOBAL]}

    def trial(self, name: str, seed: int, done: Checkpoints) -> Trial:
        """One cluster's WGAN-GP (Algorithm 2), or the global one."""
        if name == GLOBAL:
            local = local_names(self.config.clusters.count)
            critics = [self.load(self.config.local, done[one], "critic") for one in local]
            module = GuidedModule(self.config.global_, *self.given(None, seed), critics=critics)
            return Trial(module, self.config.global_)
        cluster = int(name.removeprefix("local-"))
        local_module = WganGpModule(self.config.local, *self.given(cluster, seed))
        return Trial(local_module, self.config.local, self.arrays.part(cluster))
