"""The paper's baseline: the variational auto-encoder of the pictures trained together with the WGAN-GP."""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from training.config import TrainConfig, VaeConfig
from training.models.autoencoders import Decoder, Encoder, kl_divergence, reconstruction_loss, shown
from training.models.data import Batch
from training.models.families import Checkpoints, Trial, register
from training.models.families.wgan_gp import GanConfig, WganGp, WganGpModule


class JointGanConfig(GanConfig):
    """The WGAN-GP, and the weight of the pictures in its generator's loss."""

    reconstruction_weight: float = Field(
        1.0, ge=0, description="of the decoded pictures' error; 0 leaves the KL term alone"
    )

    @model_validator(mode="after")
    def _latents_change(self) -> "JointGanConfig":
        if self.critic_condition != "projection":
            raise ValueError("an encoder that learns takes critic_condition=projection: latents change")
        return self


class JointConfig(TrainConfig):
    """Everything that fixes a job that trains the encoder with the generator."""

    trains_encoder: ClassVar[bool] = True
    global_: JointGanConfig = Field(JointGanConfig(critic_condition="projection"), alias="global")

    @property
    def reads_pictures(self) -> bool:
        """It encodes and decodes them."""
        return True

    @model_validator(mode="after")
    def _pictures_are_of_a_plane(self) -> "JointConfig":
        if self.vae.checkpoint is not None:
            raise ValueError("clusters.form=joint trains its own encoder; leave vae.checkpoint out")
        if self.known_world is not None and self.known_world.sensor.extent_m is None:
            raise ValueError("clusters.form=joint reads pictures of a plane, not arrays of space")
        return self


class JointModule(WganGpModule):
    """A conditioned WGAN-GP whose generator step trains the encoder, too (eq. generatorAndVAE).

    The critic knows scenarios by their ids, so the encoder learns from the generator's loss and from the
    VAE's alone. All pictures are encoded once a step, before anything changes; the critic's steps read the
    latents, the generator's step sends its gradient through them.

    ``images`` (S, 3, P, P) uint8, one a scenario.
    """

    config: JointGanConfig
    images: Tensor

    def __init__(self, config: JointGanConfig, *given: Any, vae: VaeConfig, images: Tensor) -> None:
        super().__init__(config, *given)
        self.vae = vae
        self.register_buffer("images", images, persistent=False)
        self.encoder = Encoder(images.shape[1:], vae.latent_dim, vae.width, vae.patches)
        self.decoder = Decoder(images.shape[1:], vae.latent_dim, vae.width)
        parts = (self.generator, self.encoder, self.decoder)
        learning = [parameter for part in parts for parameter in part.parameters()]
        self.set_optimisers(learning, config.generator_learning_rate)
        self._latents = torch.empty(0), torch.empty(0)

    def training_step(self, step: int, batch_index: int) -> None:
        """Encode the pictures, then the WGAN-GP's step."""
        self._latents = self.encoder(self.images.float() / 127.5 - 1.0)
        super().training_step(step, batch_index)

    def critic_step_loss(self, batch: Batch) -> Tensor:
        """The WGAN-GP's, with the latents of now and no way back to the encoder."""
        mu, log_variance = self._latents
        return super().critic_step_loss(_encoded(batch, mu.detach(), log_variance.detach()))

    def generator_step_loss(self, batch: Batch) -> Tensor:
        """-f(fake) + reconstruction + KL (eq. generatorAndVAE, which prints no reconstruction)."""
        mu, log_variance = self._latents
        loss = super().generator_step_loss(_encoded(batch, mu, log_variance))
        kl = kl_divergence(mu, log_variance).mean()
        self.latest["kl"] = kl.detach()
        loss = loss + kl
        if self.config.reconstruction_weight > 0.0:
            reconstruction = self._reconstruction()
            self.latest["reconstruction_loss"] = reconstruction.detach()
            loss = loss + self.config.reconstruction_weight * reconstruction
        return loss

    def _reconstruction(self) -> Tensor:
        """Mean error of a few decoded pictures."""
        rows = torch.randint(len(self.images), (self.vae.batch_size,), generator=self.rng, device=self.device)
        mu, log_variance = (part[rows] for part in self._latents)
        latent = mu + (log_variance / 2.0).exp() * self.normal(*mu.shape)
        pictures = self.images[rows].float() / 127.5 - 1.0
        return reconstruction_loss(pictures, self.decoder(latent)).mean()


def _encoded(batch: Batch, mu: Tensor, log_variance: Tensor) -> Batch:
    """The batch with the latents of its scenarios, (S, L) mean and log variance."""
    return replace(batch, mu=mu[batch.ids], sigma=(log_variance / 2.0).exp()[batch.ids])


@register("joint")
class Joint(WganGp):
    """One WGAN-GP on all configurations, and the encoder with it."""

    configuration = JointConfig

    def trial(self, name: str, seed: int, done: Checkpoints) -> Trial:
        """The WGAN-GP with encoder and decoder."""
        del name, done
        images = torch.tensor(shown(self.arrays.world.sensor, np.asarray(self.arrays.images)))
        given = self.given(None, seed)
        module = JointModule(self.config.global_, *given, vae=self.config.vae, images=images)
        return Trial(module, self.config.global_)
