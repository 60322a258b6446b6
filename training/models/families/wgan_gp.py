"""One WGAN-GP on all configurations, with a separately trained encoder; what other families build on.

After J. Ocampo Jimenez and W. Suleiman, "Improving Path Planning Performance through Multimodal Generative
Models with Local Critics"; Gulrajani et al. 2017 for the penalty. docs/paper.md lists the deviations, each of
which mends a misprint.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.optim.lr_scheduler import LambdaLR

from cspace.bundle import RandomInput
from cspace.space import JointSpace
from training.config import AdversarialConfig, TrainConfig
from training.models.checkpoint import trained
from training.models.data import Batch, ScenarioSamples
from training.models.export import Sampler
from training.models.families import Checkpoints, Family, Trial, register
from training.models.joints import Joints
from training.models.lookups import Readers, read, values_read
from training.models.modules import TrialModule, differentiate, mlp, near_zero


class GanConfig(AdversarialConfig):
    """One WGAN-GP: generator, critic, losses and budget."""

    generator: Literal["torus", "means"] = Field("torus", description="means: the paper's")
    hidden: int = Field(128, ge=1, description="units of the generator's layers")
    means: int = Field(1, ge=1, description="K of the means generator")
    sigma: float = Field(0.0, ge=0, description="standard deviation round each mean, on standardised angles")
    smooth_maximum: float | None = Field(
        None, gt=0, description="epsilon of the smooth maximum; none switches it off"
    )
    critic_condition: Literal["latent", "projection"] = Field(
        "latent", description="projection: on an embedding of the scenario, as in the paper"
    )
    critic_features: Literal["torus", "standardised"] = Field(
        "torus", description="of configurations: harmonics, or standardised angles as in the paper"
    )
    critic_hidden: int = Field(128, ge=1, description="units of the critic's layers")
    generator_learning_rate: float = Field(1e-3, gt=0, description="Adam's, of the generator")
    decay_from: float = Field(0.4, ge=0, le=1, description="share of the steps after which the rates fall")

    @model_validator(mode="after")
    def _means_need_their_generator(self) -> "GanConfig":
        if self.generator == "torus" and (self.means != 1 or self.sigma != 0.0):
            raise ValueError(
                "means and sigma belong to generator=means; the torus generator takes means=1, sigma=0"
            )
        return self


class PlainConfig(TrainConfig):
    """Everything that fixes a job that trains one WGAN-GP."""

    global_: GanConfig = Field(GanConfig(), alias="global")


@dataclass(frozen=True, slots=True)
class Sizes:
    """What generators and critics of one joint space have in common."""

    space: JointSpace
    latent_dim: int
    hidden: int
    layers: int
    looked_up: int = 0

    def mlp(self, inputs: int, outputs: int) -> nn.Sequential:
        """A perceptron of these sizes; what is looked up stands behind the other inputs."""
        return mlp(inputs + self.looked_up, self.hidden, self.layers, outputs)


def beside(parts: list[Tensor], seen: Tensor | None) -> Tensor:
    """Inputs side by side, (m, ...), with what was looked up behind; None for nothing."""
    return torch.cat(parts if seen is None else [*parts, seen], dim=1)


class TorusGenerator(nn.Module):
    """theta = u + MLP(latent, harmonics of u, noise): a residual on a uniform draw u from the joint space.

    The last layer starts near zero, so training starts from the uniform sampler. The noise is explicit; an
    encoder whose sigma has become small would otherwise leave one sample a picture.

    With look-ups it also gets what the picture shows where the arm would be at the base. Beyond limits theta
    is folded back.

    Shapes: latent (m, L), base (m, d) rad, noise (m, k), seen (m, looked_up) to (m, 1, d) rad.
    """

    def __init__(self, sizes: Sizes, noise_dim: int) -> None:
        super().__init__()
        self.noise_dim, self.joints = noise_dim, Joints(sizes.space)
        self.residual = sizes.mlp(sizes.latent_dim + self.joints.features_size + noise_dim, sizes.space.dim)
        near_zero(self.residual[-1])

    def forward(self, latent: Tensor, base: Tensor, noise: Tensor, seen: Tensor | None = None) -> Tensor:
        """One configuration for each latent."""
        step: Tensor = self.residual(beside([latent, self.joints.features(base), noise], seen))
        return self.joints.fold(base + step).unsqueeze(1)


class MeansGenerator(Sampler):
    """The paper's generator: z to K means, samples N(mean, sigma^2) on standardised angles (Algorithm 1).

    Shapes: latent (m, L), noise (m, K, d) to (m, K, d) rad.
    """

    mean_rad: Tensor
    std_rad: Tensor

    def __init__(self, sizes: Sizes, means: int, sigma: float, scale: tuple[Tensor, Tensor]) -> None:
        super().__init__()
        self.joints, self.samples_per_latent, self.sigma = Joints(sizes.space), means, sigma
        self.random_inputs = (RandomInput("noise", "normal", (means, sizes.space.dim)),)
        self.net = sizes.mlp(sizes.latent_dim, means * sizes.space.dim)
        self.register_buffer("mean_rad", scale[0])
        self.register_buffer("std_rad", scale[1])
        self.scale = (self.mean_rad, self.std_rad)

    def forward(self, latent: Tensor, noise: Tensor) -> Tensor:
        """K configurations for each latent."""
        standardised = (
            self.net(latent).view(-1, self.samples_per_latent, self.joints.dim) + self.sigma * noise
        )
        return self.joints.fold(standardised * self.std_rad + self.mean_rad)


Generator = TorusGenerator | MeansGenerator


class Critic(nn.Module):
    """f(theta | scenario), conditioned on the latent or by projection on an embedding of the scenario's id.

    ``scenarios`` is the number of ids for the projection (Miyato and Koyama 2018), or None for the
    latent; ``features`` is "torus" or "standardised".

    Shapes: configurations (b, d) rad, condition (b, L) float or (b,) ids, seen (b, looked_up) to (b,).
    """

    mean_rad: Tensor
    std_rad: Tensor

    def __init__(
        self, sizes: Sizes, *, scenarios: int | None, features: str, scale: tuple[Tensor, Tensor]
    ) -> None:
        super().__init__()
        self.joints, self.torus, hidden = Joints(sizes.space), features == "torus", sizes.hidden
        inputs = sizes.looked_up + (self.joints.pair_features_size if self.torus else sizes.space.dim)
        self.ids = None if scenarios is None else nn.Embedding(scenarios, hidden)
        condition = 0 if self.ids is not None else sizes.latent_dim
        body = mlp(inputs + condition, hidden, sizes.layers - 1, hidden)
        self.body = nn.Sequential(body, nn.LeakyReLU(0.2))
        self.head = nn.Linear(hidden, 1)
        self.register_buffer("mean_rad", scale[0])
        self.register_buffer("std_rad", scale[1])

    def forward(self, configurations: Tensor, condition: Tensor, seen: Tensor | None = None) -> Tensor:
        """The critic's value of each configuration under its condition."""
        plain = (configurations - self.mean_rad) / self.std_rad
        x = self.joints.pair_features(configurations) if self.torus else plain
        x = beside([x], seen)
        body = self.body(x if self.ids is not None else torch.cat([x, condition], dim=1))
        values: Tensor = self.head(body).squeeze(-1)
        return values if self.ids is None else values + (self.ids(condition) * body).sum(dim=-1)


def gradient_penalty(critic: Callable[[Tensor], Tensor], points: Tensor, *, one_sided: bool) -> Tensor:
    """E[(|grad f| - 1)^2], or only where the norm is above 1 when one-sided (eq. wgangp).

    The two-sided form oscillates in two dimensions; the one-sided form bounds the slope and no more.

    ``points`` (b, d), interpolated.
    """
    points = points.detach().requires_grad_()
    (gradient,) = torch.autograd.grad(critic(points).sum(), points, create_graph=True)
    # The small constant keeps the derivative of the root finite at a zero gradient.
    excess = (gradient.square().sum(dim=-1) + 1e-12).sqrt() - 1.0
    if one_sided:
        excess = torch.relu(excess)
    return excess.square().mean()


def smooth_maximum(values: Tensor, epsilon: float) -> Tensor:
    """(x1 + x2 + sqrt((x1 - x2)^2 + eps^2)) / 2 over the last axis, pair by pair: (b, K) to (b,)."""
    result = values[..., 0]
    for value in values.unbind(dim=-1)[1:]:
        result = (result + value + ((result - value).square() + epsilon**2).sqrt()) / 2.0
    return result


def fake_term(values: Tensor, epsilon: float | None) -> Tensor:
    """The critic's value of K generated samples: their mean, or (mean + smooth maximum) / 2; (b, K) to (b,).

    Half of each keeps the loss invariant to a constant added to f; the printed sum lets f drift away.
    """
    mean = values.mean(dim=-1)
    if epsilon is None or values.shape[-1] == 1:
        return mean
    return (mean + smooth_maximum(values, epsilon)) / 2.0


class AdversarialModule(TrialModule, ABC):
    """A critic and a generator in turns (Algorithm 1), their rates falling towards the end.

    The settings name ``steps``, ``batch_size``, ``critic_steps``, ``critic_learning_rate``, ``betas``,
    ``penalty`` and ``penalty_weight``.
    """

    config: Any
    samples: Any
    critic: nn.Module
    decay_from = 0.4
    smooth_maximum: float | None = None

    @abstractmethod
    def generate(self, batch: Any) -> Tensor:
        """Configurations for the batch, (b, K, d) rad."""

    @abstractmethod
    def values(self, critic: nn.Module, configurations: Tensor, batch: Any) -> Tensor:
        """Critic values (b, K) of configurations (b, K, d) under the batch's condition."""

    @abstractmethod
    def interpolate(self, real: Tensor, fake: Tensor) -> Tensor:
        """Points (b, d) between real ones and generated ones (b, K, d) (eq. gangp)."""

    def critic_step_loss(self, batch: Any) -> Tensor:
        """L = f(fake) - f(real) + lambda * penalty (Algorithm 1, line 7; eq. wgangp, signs mended)."""
        with torch.no_grad():
            fake = self.generate(batch)

        def value(points: Tensor) -> Tensor:
            return self.values(self.critic, points.unsqueeze(1), batch).squeeze(1)

        real_values = value(batch.configurations)
        fake_values = fake_term(self.values(self.critic, fake, batch), self.smooth_maximum)
        wasserstein = fake_values.mean() - real_values.mean()
        between = self.interpolate(batch.configurations, fake)
        penalty = gradient_penalty(value, between, one_sided=self.config.penalty == "one_sided")
        loss: Tensor = wasserstein + self.config.penalty_weight * penalty
        self.latest |= {
            "critic_loss": loss.detach(),
            "wasserstein_estimate": -wasserstein.detach(),
            "gradient_penalty": penalty.detach(),
        }
        return loss

    def generator_loss(self, fake: Tensor, batch: Any) -> Tensor:
        """-f(fake), averaged over everything generated (Algorithm 1, line 11)."""
        return -self.values(self.critic, fake, batch).mean()

    def generator_step_loss(self, batch: Any) -> Tensor:
        """What the generator minimises over a batch."""
        loss = self.generator_loss(self.generate(batch), batch)
        self.latest["generator_loss"] = loss.detach()
        return loss

    def set_optimisers(self, generator_side: Iterable[nn.Parameter], learning_rate: float) -> None:
        """One optimiser for the critic, one for the generator and what learns with it."""
        critic_rate, betas = self.config.critic_learning_rate, self.config.betas
        self.training_optimisers = [
            torch.optim.Adam(self.critic.parameters(), lr=critic_rate, betas=betas),
            torch.optim.Adam(generator_side, lr=learning_rate, betas=betas),
        ]
        self.training_schedules = [LambdaLR(one, self._rate) for one in self.training_optimisers]

    def training_step(self, step: int, batch_index: int) -> None:
        """n_critic steps of the critic, then one of the generator (Algorithm 1, lines 3 to 11)."""
        del step, batch_index
        critic, generator = self.training_optimisers
        for _ in range(self.config.critic_steps):
            differentiate(self.critic_step_loss(self._batch()), critic)
            critic.step()
        differentiate(self.generator_step_loss(self._batch()), generator)
        self.step_optimiser(1)
        for schedule in self.training_schedules:
            schedule.step()

    def _batch(self) -> Any:
        return self.samples.draw(self.config.batch_size, self.rng)

    def _rate(self, step: int) -> float:
        done, start = step / self.config.steps, self.decay_from
        return 1.0 if done <= start else 1.0 - 0.95 * (done - start) / (1.0 - start)


class UniformBase(nn.Module):
    """A torus generator starts from the whole joint space, evenly."""

    def __init__(self, space: JointSpace) -> None:
        super().__init__()
        self.joints = Joints(space)

    def draw(self, ids: Tensor, rng: torch.Generator) -> Tensor:
        """(b, d) rad for scenarios (b,), which do not matter."""
        shares = torch.rand(len(ids), self.joints.dim, generator=rng, device=ids.device)
        return self.joints.from_torus((2.0 * shares - 1.0) * torch.pi)


class WganGpModule(AdversarialModule):
    """WGAN-GP over configurations (Algorithm 1).

    ``scale`` mean and standard deviation of all configurations, each (d,) rad; ``base`` draws what a torus
    generator starts from.
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
        base: UniformBase | None = None,
        readers: Readers = (None, None),
    ) -> None:
        super().__init__(seed)
        self.config, self.samples, self.joints = config, samples, Joints(space)
        self.decay_from, self.smooth_maximum = config.decay_from, config.smooth_maximum
        self.base = UniformBase(space) if base is None else base
        self.generator_reader, self.critic_reader = readers
        scenarios, latent_dim = samples.mu.shape
        sizes = Sizes(space, latent_dim, config.hidden, config.layers, values_read(self.generator_reader))
        self.generator: Generator
        if config.generator == "means":
            self.generator = MeansGenerator(sizes, config.means, config.sigma, scale)
        else:
            self.generator = TorusGenerator(sizes, config.noise_dim)
        looked_up = values_read(self.critic_reader)
        self.critic = Critic(
            Sizes(space, latent_dim, config.critic_hidden, config.critic_layers, looked_up),
            scenarios=scenarios if config.critic_condition == "projection" else None,
            features=config.critic_features,
            scale=scale,
        )
        self.set_optimisers(self.generator.parameters(), config.generator_learning_rate)

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

    def interpolate(self, real: Tensor, fake: Tensor) -> Tensor:
        """Between each real configuration and one of its generated ones; on the torus the shorter way."""
        one = fake[:, int(torch.randint(fake.shape[1], (1,), generator=self.rng, device=self.device))]
        share = self.uniform(len(real), 1)
        if self.config.critic_features == "torus":
            return self.joints.interpolate(one, real, share)
        return one + share * (real - one)


class TorusSampler(Sampler):
    """A torus generator as a bundle holds it; its base is uniform on the torus whatever the limits are."""

    def __init__(self, generator: TorusGenerator) -> None:
        super().__init__()
        self.generator = generator
        self.random_inputs = (
            RandomInput("base", "uniform", (generator.joints.dim,), -math.pi, math.pi),
            RandomInput("noise", "normal", (generator.noise_dim,)),
        )

    def forward(self, latent: Tensor, base: Tensor, noise: Tensor) -> Tensor:
        """One configuration for each latent, (m, 1, d) rad."""
        samples: Tensor = self.generator(latent, self.generator.joints.from_torus(base), noise)
        return samples


GLOBAL = "global"


@register("wgan_gp")
class WganGp(Family[Any]):
    """One WGAN-GP on the configurations of all scenarios."""

    configuration: ClassVar[type[TrainConfig]] = PlainConfig

    def stages(self) -> Mapping[str, Sequence[str]]:
        """One trial."""
        return {GLOBAL: [GLOBAL]}

    def trial(self, name: str, seed: int, done: Checkpoints) -> Trial:
        """The WGAN-GP (Algorithm 1)."""
        del name, done
        return Trial(WganGpModule(self.config.global_, *self.given(None, seed)), self.config.global_)

    def given(self, cluster: int | None, seed: int, base: UniformBase | None = None) -> tuple[Any, ...]:
        """What a module of :class:`WganGpModule` takes after its settings: one cluster's data, or all."""
        arrays = self.arrays
        return arrays.samples(cluster), arrays.scale, seed, arrays.world.space, base

    def sampler(self, done: Checkpoints) -> Sampler:
        """The global generator."""
        generator = self.load(self.config.global_, done[GLOBAL], "generator")
        return generator if isinstance(generator, Sampler) else TorusSampler(generator)

    def load(self, config: GanConfig, checkpoint: Path, part: str) -> Any:
        """The generator or the critic of a trial's checkpoint."""
        return trained(
            lambda: getattr(WganGpModule(config, *self.given(None, seed=0)), part), checkpoint, part
        )
