"""Lightning modules of the path models: flow matching and WGAN-GP."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from cspace.space import JointSpace
from training.models import losses
from training.models.lookups.lookups import Reader, Scenes, make_reader, read, values_read
from training.models.modules import AdversarialModule, TrialModule
from training.models.networks import Critic, Sizes
from training.models.paths.condition import Condition
from training.models.paths.points import Look, PathCritic, PathFlow, PathGenerator
from training.models.paths.samples import PathBatch, PathSamples
from training.models.paths.settings import FlowConfig, PathGanConfig, PointConfig
from training.models.space.joints import Joints


class PointModule(TrialModule):
    """What both share: the paths, the latents, the look-ups.

    Args:
        config: sizes and budget.
        samples: the paths.
        scenes: their pictures; None where nothing is looked up.
        seed: of initialisation and of every draw.
        space: the joint space.
    """

    samples: PathSamples

    def __init__(
        self, config: PointConfig, samples: PathSamples, scenes: Scenes | None, seed: int, space: JointSpace
    ) -> None:
        super().__init__(seed)
        self.samples, self.place, self.joints = samples, config.place, Joints(space)
        self.reader = make_reader(config.lookups, scenes)
        self.sizes = point_sizes(config, space, samples.mu.shape[1], values_read(self.reader))

    def condition(self, batch: PathBatch) -> Condition:
        """Of a batch, its latents drawn."""
        latent = batch.mu + batch.sigma * self.normal(*batch.mu.shape)
        return Condition(latent, batch.start, batch.goal, batch.place if self.place else None)

    def look(self, batch: PathBatch) -> Look:
        """What the batch's pictures show at configurations (b, d)."""
        return lambda configurations: read(self.reader, batch.ids, configurations)


class FlowModule(PointModule):
    """Conditional flow matching along the shortest way round from a uniform draw to a path's point."""

    def __init__(
        self, config: FlowConfig, samples: PathSamples, scenes: Scenes | None, seed: int, space: JointSpace
    ) -> None:
        super().__init__(config, samples, scenes, seed, space)
        self.config = config
        self.net = PathFlow(self.sizes, config.evaluations, place=config.place)
        self.one_cycle(self.parameters(), config.learning_rate, config.steps)

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
        self.descend(loss)
        self.latest = {"flow_loss": loss.detach()}


class PathGanModule(PointModule, AdversarialModule):
    """WGAN-GP over points of paths (Algorithm 1 with start and goal beside the latent).

    Args:
        config: sizes and budget.
        samples: the paths.
        scenes: their pictures; None where nothing is looked up.
        seed: of initialisation and of every draw.
        space: the joint space.
        guides: frozen local critics of the configuration space, conditioned on the same latents.
        guide_reader: of their look-ups; None without.
    """

    config: PathGanConfig
    samples: PathSamples

    def __init__(
        self,
        config: PathGanConfig,
        samples: PathSamples,
        scenes: Scenes | None,
        seed: int,
        space: JointSpace,
        guides: list[Critic] | None = None,
        guide_reader: Reader | None = None,
    ) -> None:
        super().__init__(config, samples, scenes, seed, space)
        self.config = config
        self.net = PathGenerator(self.sizes, config.noise_dim, place=config.place)
        critic = replace(self.sizes, hidden=config.critic_hidden, layers=config.critic_layers)
        self.critic = PathCritic(critic, place=config.place)
        self.guides = nn.ModuleList(guides or []).requires_grad_(requires_grad=False)
        self.guide_reader = guide_reader
        self.set_optimisers(self.critic, self.net.parameters(), config.learning_rate)

    def _generate(self, batch: PathBatch) -> Tensor:
        condition = self.condition(batch)
        noise = self.normal(len(batch.ids), self.net.noise_dim)
        points: Tensor = self.net(condition, noise, self.look(batch))
        return points

    def _known(self, batch: PathBatch) -> Tensor:
        """What the critic knows of the points: the latent's mean, not the draw that the generator got."""
        place = batch.place if self.place else None
        return Condition(batch.mu, batch.start, batch.goal, place).features(self.joints)

    def critic_step_loss(self, batch: PathBatch) -> Tensor:
        """f(fake) - f(real) with the penalty (Algorithm 1, line 7)."""
        with torch.no_grad():
            fake = self._generate(batch)
        features, look = self._known(batch), self.look(batch)

        def value(points: Tensor) -> Tensor:
            values: Tensor = self.critic(points, features, look(points))
            return values

        wasserstein = losses.critic_loss(value(batch.points), value(fake))
        share = self.uniform(len(fake), 1)
        between = self.joints.between(fake, batch.points, share)
        penalty = losses.gradient_penalty(value, between, one_sided=self.config.penalty == "one_sided")
        self.latest |= {"wasserstein_estimate": -wasserstein.detach(), "gradient_penalty": penalty.detach()}
        return wasserstein + self.config.penalty_weight * penalty

    def generator_step_loss(self, batch: PathBatch) -> Tensor:
        """-f(fake), with the guides' mean where they have a weight (line 11; eq. multiDirector)."""
        fake = self._generate(batch)
        values = self.critic(fake, self._known(batch), self.look(batch)(fake))
        guides = list(self.guides) if self.config.guide_weight > 0.0 else []
        guided = [guide(fake, batch.mu, read(self.guide_reader, batch.ids, fake)) for guide in guides]
        loss = losses.guided_generator_loss(values, guided, self.config.guide_weight)
        self.latest["generator_loss"] = loss.detach()
        return loss


def point_sizes(config: PointConfig, space: JointSpace, latent_dim: int, looked_up: int) -> Sizes:
    """Sizes of the network that settings name; ``looked_up`` is what its look-ups read of a picture."""
    return Sizes(space, latent_dim, config.hidden, config.layers, looked_up)
