"""The Lightning shells of the path models that give points: flow matching, conditional VAE, WGAN-GP."""

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.optim.lr_scheduler import LambdaLR, OneCycleLR

from cspace.space import JointSpace
from training.models import losses
from training.models.lookups.lookups import PictureReader, Scenes, make_reader, values_read
from training.models.modules import TrialModule
from training.models.networks import Critic
from training.models.paths.condition import Condition
from training.models.paths.points import (
    Look,
    PathCritic,
    PathDecoder,
    PathFlow,
    PathRecogniser,
    RefiningGenerator,
    blind,
)
from training.models.paths.samples import PathBatch, PathSamples
from training.models.paths.settings import FlowConfig, PathGanConfig, PathVaeConfig, PointConfig
from training.models.space.joints import Joints


class PointModule(TrialModule):
    """What the three share: the paths, the latents, the look-ups.

    Args:
        config: sizes and budget.
        samples: the paths.
        scenes: their pictures; None where nothing is looked up.
        seed: of initialisation and of every draw.
        space: the joint space; None for circles alone.
    """

    def __init__(
        self,
        config: PointConfig,
        samples: PathSamples,
        scenes: Scenes | None,
        seed: int,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__(seed)
        self.samples, self.place, self.space = samples, config.place, space
        self.dim, self.latent_dim = samples.paths.shape[2], samples.mu.shape[1]
        self.joints = Joints.of(space, self.dim)
        self.reader: PictureReader | None = make_reader(config.lookups, scenes)
        self.looked_up = values_read(self.reader)

    def on_fit_start(self) -> None:
        """Keep the data where the model is."""
        self.samples = self.samples.to(self.device)

    def condition(self, batch: PathBatch) -> Condition:
        """Of a batch, its latents drawn."""
        latent = batch.mu + batch.sigma * self.normal(*batch.mu.shape)
        return Condition(latent, batch.start, batch.goal, batch.place if self.place else None)

    def look(self, batch: PathBatch) -> Look:
        """What the batch's pictures show at configurations (b, d)."""
        reader = self.reader
        return blind if reader is None else lambda configurations: reader(batch.ids, configurations)


class FlowModule(PointModule):
    """Conditional flow matching along the shortest way round from a uniform draw to a path's point."""

    def __init__(
        self,
        config: FlowConfig,
        samples: PathSamples,
        scenes: Scenes | None,
        seed: int,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__(config, samples, scenes, seed, space)
        self.config = config
        self.net = make_flow(config, self.dim, self.latent_dim, self.looked_up, space)
        one_cycle(self, self.parameters(), config.learning_rate, config.steps)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of the regression on velocities."""
        del step, batch_index
        batch = self.samples.draw(self.config.batch_size, self.rng)
        base = self.joints.from_torus((2.0 * self.uniform(*batch.points.shape) - 1.0) * torch.pi)
        time = self.uniform(len(base), 1)
        at, way = self.joints.between(base, batch.points, time), self.joints.way(base, batch.points)
        features = self.condition(batch).features(self.joints)
        found = self.net.velocity(at, time, features, self.look(batch)(at))
        loss = (found - way).square().sum(dim=1).mean()
        descend(self, loss)
        self.latest = {"flow_loss": loss.detach()}


class PathVaeModule(PointModule):
    """The conditional VAE over points of paths."""

    def __init__(
        self,
        config: PathVaeConfig,
        samples: PathSamples,
        scenes: Scenes | None,
        seed: int,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__(config, samples, scenes, seed, space)
        self.config = config
        sizes = (self.dim, self.latent_dim, config.hidden, config.layers, config.code_dim)
        self.net = PathDecoder(*sizes, 0, place=config.place, space=space)
        self.recogniser = PathRecogniser(*sizes, place=config.place, space=space)
        one_cycle(self, self.parameters(), config.learning_rate, config.steps)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of the evidence lower bound."""
        del step, batch_index
        batch = self.samples.draw(self.config.batch_size, self.rng)
        condition = self.condition(batch)
        mean, log_variance = self.recogniser(condition, batch.points)
        code = mean + (log_variance / 2.0).exp() * self.normal(*mean.shape)
        wanted = self.joints.embed(batch.points)
        error = (self.net.embedded(condition, code) - wanted).square().sum(dim=1).mean()
        kl = losses.kl_divergence(mean, log_variance).mean()
        descend(self, error + self.config.kl_weight * kl)
        self.latest = {"path_error": error.detach(), "kl": kl.detach()}


class PathGanModule(PointModule):
    """WGAN-GP over points of paths (Algorithm 1 with start and goal beside the latent).

    Args:
        config: sizes and budget.
        samples: the paths.
        scenes: their pictures; None where nothing is looked up.
        seed: of initialisation and of every draw.
        guides: frozen local critics of the configuration space, conditioned on the same latents.
        guide_reader: of their look-ups; None without.
        space: the joint space; None for circles alone.
    """

    def __init__(
        self,
        config: PathGanConfig,
        samples: PathSamples,
        scenes: Scenes | None,
        seed: int,
        guides: list[Critic] | None = None,
        guide_reader: PictureReader | None = None,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__(config, samples, scenes, seed, space)
        self.config = config
        shape = (self.dim, self.latent_dim, config.hidden, config.layers)
        self.net = make_path_generator(config, self.dim, self.latent_dim, self.looked_up, space)
        critic = (*shape[:2], config.critic_hidden, config.critic_layers, self.looked_up)
        self.critic = PathCritic(*critic, place=config.place, space=space)
        self.guides = nn.ModuleList(guides or []).requires_grad_(requires_grad=False)
        self.guide_reader = guide_reader
        self.training_optimisers = [
            torch.optim.Adam(self.critic.parameters(), lr=config.critic_learning_rate, betas=config.betas),
            torch.optim.Adam(self.net.parameters(), lr=config.learning_rate, betas=config.betas),
        ]
        self.training_schedules = [LambdaLR(one, self._rate) for one in self.training_optimisers]

    def training_step(self, step: int, batch_index: int) -> None:
        """n_critic steps of the critic, then one of the generator."""
        del step, batch_index
        critic, generator = self.training_optimisers
        for _ in range(self.config.critic_steps):
            loss = self._critic_loss(self.samples.draw(self.config.batch_size, self.rng))
            critic.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            critic.step()
        loss = self._generator_loss(self.samples.draw(self.config.batch_size, self.rng))
        generator.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        generator.step()
        for schedule in self.training_schedules:
            schedule.step()

    def _generate(self, batch: PathBatch, condition: Condition) -> Tensor:
        points: Tensor = self.net(
            condition, self.normal(len(batch.ids), self.net.noise_dim), self.look(batch)
        )
        return points

    def _critic_loss(self, batch: PathBatch) -> Tensor:
        condition, look = self.condition(batch), self.look(batch)
        with torch.no_grad():
            fake = self._generate(batch, condition)
        # The critic sees the mean, not the draw that the generator got.
        features = Condition(batch.mu, batch.start, batch.goal, condition.place).features(self.joints)

        def value(points: Tensor) -> Tensor:
            values: Tensor = self.critic(points, features, look(points))
            return values

        wasserstein = losses.critic_loss(value(batch.points), value(fake))
        share = self.uniform(len(fake), 1)
        between = self.joints.between(fake, batch.points, share)
        penalty = losses.gradient_penalty(value, between, one_sided=self.config.penalty == "one_sided")
        self.latest |= {"wasserstein_estimate": -wasserstein.detach(), "gradient_penalty": penalty.detach()}
        return wasserstein + self.config.penalty_weight * penalty

    def _generator_loss(self, batch: PathBatch) -> Tensor:
        condition = self.condition(batch)
        fake = self._generate(batch, condition)
        features = Condition(batch.mu, batch.start, batch.goal, condition.place).features(self.joints)
        values = self.critic(fake, features, self.look(batch)(fake))
        guided = []
        for guide in self.guides if self.config.guide_weight > 0.0 else []:
            seen = None if self.guide_reader is None else self.guide_reader(batch.ids, fake)
            guided.append(guide(fake, batch.mu, seen))
        loss = losses.guided_generator_loss(values, guided, self.config.guide_weight)
        self.latest["generator_loss"] = loss.detach()
        return loss

    def _rate(self, step: int) -> float:
        done = step / self.config.steps
        return 1.0 if done <= 0.4 else 1.0 - 0.95 * (done - 0.4) / 0.6


def make_flow(
    config: FlowConfig, dim: int, latent_dim: int, looked_up: int, space: JointSpace | None = None
) -> PathFlow:
    """The flow that a configuration names."""
    return PathFlow(
        dim,
        latent_dim,
        config.hidden,
        config.layers,
        config.evaluations,
        looked_up,
        place=config.place,
        space=space,
    )


def make_path_generator(
    config: PathGanConfig, dim: int, latent_dim: int, looked_up: int, space: JointSpace | None = None
) -> RefiningGenerator | PathDecoder:
    """The generator that a configuration names."""
    if config.refinements == 0:
        return PathDecoder(
            dim,
            latent_dim,
            config.hidden,
            config.layers,
            config.noise_dim,
            looked_up,
            place=config.place,
            space=space,
        )
    return RefiningGenerator(
        dim,
        latent_dim,
        config.hidden,
        config.layers,
        config.noise_dim,
        config.refinements,
        looked_up,
        place=config.place,
        space=space,
    )


def one_cycle(
    module: TrialModule, parameters: Iterable[nn.Parameter], learning_rate: float, steps: int
) -> None:
    """Give a module Adam with a learning rate that rises once and falls."""
    optimiser = torch.optim.Adam(parameters, lr=learning_rate)
    module.training_optimisers = [optimiser]
    module.training_schedules = [OneCycleLR(optimiser, learning_rate, total_steps=steps + 1, pct_start=0.1)]


def descend(module: TrialModule, loss: Tensor) -> None:
    """One step of the module's only optimiser and its schedule."""
    (optimiser,) = module.training_optimisers
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimiser.step()
    module.training_schedules[0].step()
