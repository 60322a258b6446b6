"""Path models: conditions, networks, training data, and Lightning modules of flow matching and WGAN-GP."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cspace.dataset import Dataset
from cspace.errors import DatasetError
from cspace.planning.paths import spread_points
from cspace.space import JointSpace
from training.models import losses
from training.models.data import Held
from training.models.joints import Joints
from training.models.lookups import Reader, Scenes, make_reader, read, values_read
from training.models.modules import AdversarialModule, TrialModule
from training.models.networks import Critic, Sizes, beside, mlp
from training.models.settings import FlowConfig, PathGanConfig, PointConfig

PLACE_FEATURES = 9


@dataclass(frozen=True, slots=True)
class Condition:
    """Of each sample.

    Args:
        latent: (m, L).
        start: (m, d) rad.
        goal: (m, d) rad.
        place: (m, 1), 0 to 1; None for models that are not asked for a place.
    """

    latent: Tensor
    start: Tensor
    goal: Tensor
    place: Tensor | None

    def features(self, joints: Joints) -> Tensor:
        """Side by side, (m, F)."""
        parts = [self.latent, joints.features(self.start), joints.features(self.goal)]
        return beside(parts, None if self.place is None else place_features(self.place))


def condition_size(latent_dim: int, joints: Joints, *, place: bool) -> int:
    """F, of :meth:`Condition.features`."""
    return latent_dim + 2 * joints.features_size + (PLACE_FEATURES if place else 0)


def place_features(place: Tensor) -> Tensor:
    """A place with its cosines and sines of up to four half turns, (m, 1) to (m, 9)."""
    turns = torch.cat([place * (torch.pi * k) for k in range(1, 5)], dim=1)
    return torch.cat([place, torch.cos(turns), torch.sin(turns)], dim=1)


def swept(place: Tensor, sweep: int) -> Tensor:
    """Places (m, 1) in [0, 1) in rising sweeps of ``sweep`` rows, each row within its own share of the way.

    A planner draws samples in their order, and a tree that grows from the start can use them best from the
    start on. All rows together are as evenly spread as before; fewer rows than a sweep are one sweep.
    """
    row = torch.arange(place.shape[0], device=place.device)
    count = torch.clamp(row.max() + 1, max=sweep)
    return ((row % count).unsqueeze(1).to(place.dtype) + place) / count


# Power by which the steps of a flow become shorter towards its end, where the velocity is sharp.
FINER = 1.5

Look = Callable[[Tensor], Tensor | None]


class PathFlow(nn.Module):
    """Velocity from a uniform draw on the torus to a point of the path, and the way along it.

    Shapes: at (m, d) rad, time (m, 1), features (m, F), seen (m, values) or None to (m, d) rad.
    """

    def __init__(self, sizes: Sizes, evaluations: int, *, place: bool) -> None:
        super().__init__()
        self.joints, self.evaluations, self.noise_dim = Joints(sizes.space), evaluations, sizes.space.dim
        inputs = condition_size(sizes.latent_dim, self.joints, place=place) + self.joints.features_size
        self.net = sizes.mlp(inputs + PLACE_FEATURES, sizes.space.dim)

    def velocity(self, at: Tensor, time: Tensor, features: Tensor, seen: Tensor | None) -> Tensor:
        """Where a point moves, rad in a unit of time."""
        moved: Tensor = self.net(beside([features, self.joints.features(at), place_features(time)], seen))
        return moved

    def forward(self, condition: Condition, noise: Tensor, look: Look) -> Tensor:
        """Points (m, d) rad from noise (m, d) uniform in [-pi, pi), by the midpoint rule."""
        at, features = self.joints.from_torus(noise), condition.features(self.joints)
        steps = (self.evaluations + 1) // 2
        for index in range(steps):
            begin, end = (1.0 - (1.0 - step / steps) ** FINER for step in (index, index + 1))
            length, time = end - begin, torch.full_like(at[:, :1], begin)
            speed = self.velocity(at, time, features, look(at))
            # An odd number of evaluations leaves one for the last step.
            if 2 * index + 1 < self.evaluations:
                halfway = at + speed * (length / 2.0)
                speed = self.velocity(halfway, time + length / 2.0, features, look(halfway))
            at = at + speed * length
        return self.joints.fold(at)


class PathGenerator(nn.Module):
    """A code to a point, as an embedding: code (m, k), condition to (m, d) rad; it looks nothing up."""

    def __init__(self, sizes: Sizes, code_dim: int, *, place: bool) -> None:
        super().__init__()
        self.noise_dim, self.joints = code_dim, Joints(sizes.space)
        inputs = condition_size(sizes.latent_dim, self.joints, place=place) + code_dim
        self.net = mlp(inputs, sizes.hidden, sizes.layers, self.joints.embedded_size)

    def embedded(self, condition: Condition, code: Tensor) -> Tensor:
        """Cosines, then sines, of any length, then places within limits; (m, e)."""
        values: Tensor = self.net(torch.cat([condition.features(self.joints), code], dim=1))
        return values

    def forward(self, condition: Condition, noise: Tensor, look: Look) -> Tensor:
        """Points (m, d) rad; it reads no picture."""
        del look
        return self.joints.unembed(self.embedded(condition, noise))


class PathCritic(nn.Module):
    """f(point | condition): points (m, d) rad, features (m, F), seen (m, values) or None to (m,)."""

    def __init__(self, sizes: Sizes, *, place: bool) -> None:
        super().__init__()
        self.joints = Joints(sizes.space)
        inputs = condition_size(sizes.latent_dim, self.joints, place=place) + self.joints.pair_features_size
        self.net = sizes.mlp(inputs, 1)

    def forward(self, points: Tensor, features: Tensor, seen: Tensor | None) -> Tensor:
        """The critic's value."""
        values: Tensor = self.net(beside([features, self.joints.pair_features(points)], seen)).squeeze(1)
        return values


MIN_POINTS = 2


@dataclass(frozen=True, slots=True)
class PathBatch:
    """Points of paths.

    Args:
        points: (b, d) rad, one of each path.
        place: (b, 1) share of the path's length from its start to the point, 0 to 1.
        start: (b, d) rad.
        goal: (b, d) rad.
        ids: (b,) scenario.
        mu: (b, L) mean of the scenario's latent.
        sigma: (b, L) its standard deviation.
    """

    points: Tensor
    place: Tensor
    start: Tensor
    goal: Tensor
    ids: Tensor
    mu: Tensor
    sigma: Tensor


@dataclass(frozen=True, slots=True)
class PathSamples(Held):
    """Paths of equally many points with the latents of their scenarios.

    Args:
        paths: (T, P, d) float32 rad, points at equal distances.
        ids: (T,) int64 scenario of each path.
        mu: (S, L) float32.
        sigma: (S, L) float32.
    """

    paths: Tensor
    ids: Tensor
    mu: Tensor
    sigma: Tensor

    def draw_rows(self, size: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """Numbers of paths (b,), and which of them are walked from goal to start (b,): every other one."""
        rows = torch.randint(len(self.ids), (size,), generator=rng, device=self.ids.device)
        # What is a near-optimal path one way is one the other way.
        return rows, torch.rand(size, generator=rng, device=self.ids.device) < 0.5

    def walked(self, rows: Tensor, back: Tensor) -> Tensor:
        """Those paths, (b, P, d) rad."""
        paths = self.paths[rows]
        return torch.where(back.view(-1, 1, 1), paths.flip(1), paths)

    def draw(self, size: int, rng: torch.Generator) -> PathBatch:
        """One point of each of so many paths, both with replacement."""
        rows, back = self.draw_rows(size, rng)
        paths, ids = self.walked(rows, back), self.ids[rows]
        count = paths.shape[1]
        at = torch.randint(count, (size,), generator=rng, device=ids.device)
        points = paths[torch.arange(size, device=ids.device), at]
        place = (at / (count - 1)).unsqueeze(1)
        return PathBatch(points, place, paths[:, 0], paths[:, -1], ids, self.mu[ids], self.sigma[ids])


def equal_paths(dataset: Dataset, points: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """All paths of a data set with ``points`` points at equal distances, (T, points, d), and their scenarios.

    Raises:
        DatasetError: the data set holds no paths, or one of a single point.
    """
    if not {"paths", "path_offsets", "path_scenario"} <= set(dataset.arrays):
        raise DatasetError("the data set holds no paths", expected="paths.npy", got=str(dataset.folder))
    rows, offsets = dataset.arrays["paths"], dataset.arrays["path_offsets"]
    sizes = np.diff(offsets)
    if len(sizes) == 0 or sizes.min() < MIN_POINTS:
        raise DatasetError(
            "the data set's paths do not fit",
            expected="paths of two points or more",
            got=str(sizes.min(initial=0)),
        )
    owner = np.asarray(dataset.arrays["path_scenario"])
    if (sizes == points).all():
        return np.asarray(rows).reshape(-1, points, dataset.dim), owner
    space = dataset.world.space
    parts = [spread_points(np.asarray(rows[a:b], np.float64), points, space) for a, b in pairwise(offsets)]
    return np.stack(parts).astype(np.float32), owner


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
        at, difference = (
            self.joints.interpolate(base, batch.points, time),
            self.joints.difference(base, batch.points),
        )
        features = self.condition(batch).features(self.joints)
        found = self.net.velocity(at, time, features, self.look(batch)(at))
        loss = (found - difference).square().sum(dim=1).mean()
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
        interpolated = self.joints.interpolate(fake, batch.points, share)
        penalty = losses.gradient_penalty(value, interpolated, one_sided=self.config.penalty == "one_sided")
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
