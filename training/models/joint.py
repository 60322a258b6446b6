"""The paper's baseline: the encoder of the pictures trained together with the WGAN-GP."""

from dataclasses import replace

import torch
from torch import Tensor

from cspace.space import JointSpace
from training.models import losses
from training.models.data import Batch, ScenarioSamples
from training.models.modules import WganGpModule
from training.models.networks import Decoder, Encoder
from training.models.settings import GlobalConfig, VaeConfig


class JointModule(WganGpModule):
    """A conditioned WGAN-GP whose generator step trains the encoder, too (eq. generatorAndVAE).

    The critic knows scenarios by their ids, so the encoder learns from the generator's loss and from the
    VAE's alone. All pictures are encoded once a step, before anything changes; the critic's steps read the
    latents, the generator's step sends its gradient through them.

    ``images`` (S, 3, P, P) uint8, one a scenario; ``scale`` mean and standard deviation of all
    configurations, each (d,) rad.
    """

    images: Tensor

    def __init__(
        self,
        config: GlobalConfig,
        vae: VaeConfig,
        samples: ScenarioSamples,
        images: Tensor,
        scale: tuple[Tensor, Tensor],
        seed: int,
        space: JointSpace,
    ) -> None:
        super().__init__(config, samples, scale, seed, space)
        self.vae, self.reconstruction_weight = vae, config.reconstruction_weight
        self.register_buffer("images", images, persistent=False)
        self.encoder = Encoder(images.shape[-1], vae.latent_dim, vae.width, vae.patches)
        self.decoder = Decoder(images.shape[-1], vae.latent_dim, vae.width)
        parts = (self.generator, self.encoder, self.decoder)
        learning = [parameter for part in parts for parameter in part.parameters()]
        self.set_optimisers(self.critic, learning, config.generator_learning_rate)
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
        kl = losses.kl_divergence(mu, log_variance).mean()
        self.latest["kl"] = kl.detach()
        loss = loss + self.vae.kl_weight * kl
        if self.reconstruction_weight > 0.0:
            reconstruction = self._reconstruction()
            self.latest["reconstruction_loss"] = reconstruction.detach()
            loss = loss + self.reconstruction_weight * reconstruction
        return loss

    def _reconstruction(self) -> Tensor:
        """Mean error of a few decoded pictures."""
        rows = torch.randint(len(self.images), (self.vae.batch_size,), generator=self.rng, device=self.device)
        mu, log_variance = (part[rows] for part in self._latents)
        latent = mu + (log_variance / 2.0).exp() * self.normal(*mu.shape)
        pictures = self.images[rows].float() / 127.5 - 1.0
        return losses.reconstruction_loss(pictures, self.decoder(latent)).mean()


def _encoded(batch: Batch, mu: Tensor, log_variance: Tensor) -> Batch:
    """The batch with the latents of its scenarios, (S, L) mean and log variance."""
    return replace(batch, mu=mu[batch.ids], sigma=(log_variance / 2.0).exp()[batch.ids])
