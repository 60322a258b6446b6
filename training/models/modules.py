"""The Lightning shells: what one training step does, and nothing of clusters, trackers or files."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

import lightning
import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR, OneCycleLR

from cspace.space import JointSpace
from training.models import losses
from training.models.autoencoders import make_decoder, make_encoder
from training.models.cells import Base, UniformBase
from training.models.data import Batch, Held, ScenarioSamples
from training.models.joints import Joints
from training.models.lookups import Scenes, make_reader, read, values_read
from training.models.networks import Critic, MeansGenerator, Sizes, TorusGenerator
from training.models.settings import GanConfig, VaeConfig

Metrics = dict[str, float]


class TrialModule(lightning.LightningModule):
    """What the trials need of every model: a random stream of its own, data, optimisers, the last metrics."""

    samples: Held | None = None

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.automatic_optimization = False
        self.seed = seed
        self.latest: dict[str, Tensor] = {}
        self.training_optimisers: list[Optimizer] = []
        self.training_schedules: list[LambdaLR | OneCycleLR] = []
        self._rng: torch.Generator | None = None
        self._rng_state: Tensor | None = None

    @property
    def rng(self) -> torch.Generator:
        """The generator of every random draw in training, on the module's device."""
        if self._rng is None or self._rng.device != self.device:
            self._rng = torch.Generator(device=self.device).manual_seed(self.seed)
            if self._rng_state is not None:
                self._rng.set_state(self._rng_state)
        return self._rng

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the state of the random stream."""
        checkpoint["rng"] = self.rng.get_state()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Take the random stream up when the module is on its device."""
        self._rng, self._rng_state = None, checkpoint["rng"].cpu()

    def on_fit_start(self) -> None:
        """Keep the data where the model is."""
        if self.samples is not None:
            self.samples = self.samples.to(self.device)

    def configure_optimizers(self) -> tuple[list[Optimizer], list[LambdaLR | OneCycleLR]]:
        """The optimisers and schedules made at construction."""
        return self.training_optimisers, self.training_schedules

    def metrics(self) -> Metrics:
        """Means of the last step's losses as plain numbers."""
        return {name: float(value) for name, value in self.latest.items()}

    def normal(self, *shape: int) -> Tensor:
        """Standard normal draws from the module's own generator."""
        return torch.randn(*shape, generator=self.rng, device=self.device)

    def uniform(self, *shape: int) -> Tensor:
        """Uniform draws in [0, 1) from the module's own generator."""
        return torch.rand(*shape, generator=self.rng, device=self.device)

    def one_cycle(self, parameters: Iterable[nn.Parameter], learning_rate: float, steps: int) -> None:
        """Train by Adam with a learning rate that rises once and falls."""
        optimiser = torch.optim.Adam(parameters, lr=learning_rate)
        self.training_optimisers = [optimiser]
        self.training_schedules = [OneCycleLR(optimiser, learning_rate, total_steps=steps + 1, pct_start=0.1)]

    def step_optimiser(self, index: int) -> None:
        """Step an optimiser as Lightning's, which counts it as the trainer's global step."""
        optimisers = self.optimizers()
        (optimisers if isinstance(optimisers, list) else [optimisers])[index].step()

    def descend(self, loss: Tensor, clip: float | None = None) -> None:
        """One step of the only optimiser and its schedule, the gradient's norm clipped where asked."""
        _differentiate(loss, self.training_optimisers[0])
        if clip is not None:
            nn.utils.clip_grad_norm_(self.parameters(), clip)
        self.step_optimiser(0)
        self.training_schedules[0].step()


def _differentiate(loss: Tensor, optimiser: Optimizer) -> None:
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]


class VaeModule(TrialModule):
    """The variational auto-encoder over pictures (Kingma and Welling 2014; eq. kl, mended)."""

    images: Tensor

    def __init__(self, config: VaeConfig, images: Tensor, seed: int) -> None:
        super().__init__(seed)
        self.config = config
        self.register_buffer("images", images, persistent=False)
        self.encoder = make_encoder(config, images.shape[1:])
        self.decoder = make_decoder(config, images.shape[1:])
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of the evidence lower bound, its KL term warmed up and its gradient clipped."""
        del step, batch_index
        rows = torch.randint(
            len(self.images), (self.config.batch_size,), generator=self.rng, device=self.device
        )
        # Pictures stay uint8 in memory; a float copy of thousands of them would be four times as large.
        pictures = self.images[rows].float() / 127.5 - 1.0
        mu, log_variance = self.encoder.of_shown(pictures)
        latent = mu + (log_variance / 2.0).exp() * self.normal(*mu.shape)
        reconstruction = losses.reconstruction_loss(pictures, self.decoder(latent)).mean()
        kl = losses.kl_divergence(mu, log_variance).mean()
        warmup = min(1.0, (self.global_step + 1) / max(1.0, self.config.kl_warmup * self.config.steps))
        loss = reconstruction + self.config.kl_weight * warmup * kl
        self.descend(loss, self.config.gradient_clip)
        self.latest = {
            "vae_loss": loss.detach(),
            "reconstruction_loss": reconstruction.detach(),
            "kl": kl.detach(),
        }


class AdversarialModule(TrialModule, ABC):
    """A critic and a generator in turns (Algorithm 1), their rates falling towards the end.

    The settings name ``steps``, ``batch_size``, ``critic_steps``, ``critic_learning_rate`` and ``betas``.
    """

    config: Any
    samples: Any
    decay_from = 0.4

    @abstractmethod
    def critic_step_loss(self, batch: Any) -> Tensor:
        """What the critic minimises over a batch."""

    @abstractmethod
    def generator_step_loss(self, batch: Any) -> Tensor:
        """What the generator minimises over a batch."""

    def set_optimisers(
        self, critic: nn.Module, generator_side: Iterable[nn.Parameter], learning_rate: float
    ) -> None:
        """One optimiser for the critic, one for the generator and what learns with it."""
        config = self.config
        self.training_optimisers = [
            torch.optim.Adam(critic.parameters(), lr=config.critic_learning_rate, betas=config.betas),
            torch.optim.Adam(generator_side, lr=learning_rate, betas=config.betas),
        ]
        self.training_schedules = [LambdaLR(one, self._rate) for one in self.training_optimisers]

    def training_step(self, step: int, batch_index: int) -> None:
        """n_critic steps of the critic, then one of the generator (Algorithm 1, lines 3 to 11)."""
        del step, batch_index
        critic, generator = self.training_optimisers
        for _ in range(self.config.critic_steps):
            _differentiate(self.critic_step_loss(self._batch()), critic)
            critic.step()
        _differentiate(self.generator_step_loss(self._batch()), generator)
        self.step_optimiser(1)
        for schedule in self.training_schedules:
            schedule.step()

    def _batch(self) -> Any:
        return self.samples.draw(self.config.batch_size, self.rng)

    def _rate(self, step: int) -> float:
        done, start = step / self.config.steps, self.decay_from
        return 1.0 if done <= start else 1.0 - 0.95 * (done - start) / (1.0 - start)


class WganGpModule(AdversarialModule):
    """WGAN-GP over configurations (Algorithm 1), local or global.

    ``scale`` mean and standard deviation of all configurations, each (d,) rad.
    """

    config: GanConfig
    samples: ScenarioSamples

    def __init__(
        self,
        config: GanConfig,
        samples: ScenarioSamples,
        scale: tuple[Tensor, Tensor],
        seed: int,
        space: JointSpace,
        local_critics: list[Critic] | None = None,
        local_weight: float = 0.0,
        base: Base | None = None,
        scenes: Scenes | None = None,
    ) -> None:
        super().__init__(seed)
        self.config, self.samples, self.local_weight = config, samples, local_weight
        self.joints, self.decay_from = Joints(space), config.decay_from
        self.base = UniformBase(space) if base is None else base
        self.generator_reader = make_reader(config.generator_lookups, scenes)
        self.critic_reader = make_reader(config.critic_lookups, scenes)
        scenarios, latent_dim = samples.mu.shape
        looked_up = values_read(self.generator_reader)
        self.generator = make_generator(config, space, latent_dim, scale, looked_up)
        looked_up = values_read(self.critic_reader)
        self.critic = make_critic(config, space, latent_dim, scenarios, scale, looked_up)
        self.local_critics = nn.ModuleList(local_critics or []).requires_grad_(requires_grad=False)
        self.set_optimisers(self.critic, self.generator.parameters(), config.generator_learning_rate)

    def generate(self, batch: Batch) -> Tensor:
        """Configurations for the batch's scenarios, (b, K, d) rad."""
        latent = batch.mu + batch.sigma * self.normal(*batch.mu.shape)
        size, dim = batch.configurations.shape
        if isinstance(self.generator, MeansGenerator):
            samples: Tensor = self.generator(latent, self.normal(size, self.config.means, dim))
        else:
            base = self.base.draw(batch.ids, self.rng)
            seen = read(self.generator_reader, batch.ids, base)
            samples = self.generator(latent, base, self.normal(size, self.config.noise_dim), seen)
        return samples

    def values(self, critic: nn.Module, configurations: Tensor, batch: Batch) -> Tensor:
        """Critic values (b, K) of configurations (b, K, d) under the batch's scenarios."""
        size, count, dim = configurations.shape
        condition = batch.mu if self.config.critic_condition == "latent" else batch.ids
        rows = configurations.reshape(-1, dim)
        seen = read(self.critic_reader, batch.ids.repeat_interleave(count), rows)
        flat: Tensor = critic(rows, condition.repeat_interleave(count, dim=0), seen)
        return flat.view(size, count)

    def critic_step_loss(self, batch: Batch) -> Tensor:
        """L = f(fake) - f(real) + lambda * penalty (Algorithm 1, line 7)."""
        with torch.no_grad():
            fake = self.generate(batch)
        real_values = self.values(self.critic, batch.configurations.unsqueeze(1), batch).squeeze(1)
        fake_values = losses.fake_term(self.values(self.critic, fake, batch), self.config.smooth_maximum)
        wasserstein = losses.critic_loss(real_values, fake_values)
        penalty = losses.gradient_penalty(
            lambda points: self.values(self.critic, points.unsqueeze(1), batch).squeeze(1),
            self._interpolated(batch.configurations, fake),
            one_sided=self.config.penalty == "one_sided",
        )
        loss = wasserstein + self.config.penalty_weight * penalty
        self.latest |= {
            "critic_loss": loss.detach(),
            "wasserstein_estimate": -wasserstein.detach(),
            "gradient_penalty": penalty.detach(),
        }
        return loss

    def generator_step_loss(self, batch: Batch) -> Tensor:
        """-f(fake), for the global generator with the local critics' mean (line 11; eq. multiDirector)."""
        fake = self.generate(batch)
        local = [] if self.local_weight == 0.0 else [self.values(c, fake, batch) for c in self.local_critics]
        loss = losses.guided_generator_loss(self.values(self.critic, fake, batch), local, self.local_weight)
        self.latest["generator_loss"] = loss.detach()
        return loss

    def _interpolated(self, real: Tensor, fake: Tensor) -> Tensor:
        one = fake[:, int(torch.randint(fake.shape[1], (1,), generator=self.rng, device=self.device))]
        share = self.uniform(len(real), 1)
        if self.config.critic_features == "torus":
            return self.joints.interpolate(one, real, share)
        return losses.straight_interpolation(real, one, share)


def make_generator(
    config: GanConfig, space: JointSpace, latent_dim: int, scale: tuple[Tensor, Tensor], looked_up: int
) -> TorusGenerator | MeansGenerator:
    """The generator that settings name; ``looked_up`` is what its look-ups read of a picture."""
    sizes = Sizes(space, latent_dim, config.hidden, config.layers, looked_up)
    if config.generator == "means":
        return MeansGenerator(sizes, config.means, config.sigma, scale)
    return TorusGenerator(sizes, config.noise_dim)


def make_critic(
    config: GanConfig,
    space: JointSpace,
    latent_dim: int,
    scenarios: int,
    scale: tuple[Tensor, Tensor],
    looked_up: int,
) -> Critic:
    """The critic that settings name; ``scenarios`` is the number of ids for its projection."""
    return Critic(
        Sizes(space, latent_dim, config.critic_hidden, config.critic_layers, looked_up),
        scenarios=scenarios if config.critic_condition == "projection" else None,
        features=config.critic_features,
        scale=scale,
    )
