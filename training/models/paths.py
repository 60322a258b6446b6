"""The path model: condition, networks, training data and WGAN-GP (Algorithm 3)."""

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
from training.config import PathGanConfig
from training.models.data import Held
from training.models.export import Graph, batched, exported
from training.models.families.wgan_gp import AdversarialModule, Sizes
from training.models.joints import Joints
from training.models.modules import mlp


@dataclass(frozen=True, slots=True)
class Condition:
    """Of each sample: latent (m, L), start and goal (m, d) rad."""

    latent: Tensor
    start: Tensor
    goal: Tensor

    def features(self, joints: Joints) -> Tensor:
        """Side by side, (m, F)."""
        return torch.cat([self.latent, joints.features(self.start), joints.features(self.goal)], dim=1)


def condition_size(latent_dim: int, joints: Joints) -> int:
    """F, of :meth:`Condition.features`."""
    return latent_dim + 2 * joints.features_size


class PathGenerator(nn.Module):
    """A code to a point, as an embedding: code (m, k), condition to (m, d) rad."""

    def __init__(self, sizes: Sizes, code_dim: int) -> None:
        super().__init__()
        self.noise_dim, self.joints = code_dim, Joints(sizes.space)
        inputs = condition_size(sizes.latent_dim, self.joints) + code_dim
        self.net = mlp(inputs, sizes.hidden, sizes.layers, self.joints.embedded_size)

    def forward(self, condition: Condition, noise: Tensor) -> Tensor:
        """Points (m, d) rad."""
        return self.joints.unembed(self.net(torch.cat([condition.features(self.joints), noise], dim=1)))


class PathCritic(nn.Module):
    """f(point | condition): points (m, d) rad and features (m, F) to (m,)."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.joints = Joints(sizes.space)
        inputs = condition_size(sizes.latent_dim, self.joints) + self.joints.pair_features_size
        self.net = mlp(inputs, sizes.hidden, sizes.layers, 1)

    def forward(self, points: Tensor, features: Tensor) -> Tensor:
        """The critic's value."""
        values: Tensor = self.net(torch.cat([features, self.joints.pair_features(points)], dim=1)).squeeze(1)
        return values


@dataclass(frozen=True, slots=True)
class PathBatch:
    """Points of paths."""

    configurations: Tensor  # (b, d) rad, a point of each path
    start: Tensor  # (b, d) rad
    goal: Tensor  # (b, d) rad
    ids: Tensor  # (b,) scenario
    mu: Tensor  # (b, L) mean of the scenario's latent
    sigma: Tensor  # (b, L) its standard deviation


@dataclass(frozen=True, slots=True)
class PathSamples(Held):
    """Paths of equally many points with the latents of their scenarios."""

    paths: Tensor  # (T, P, d) float32 rad, points at equal distances
    ids: Tensor  # (T,) int64 scenario of each path
    mu: Tensor  # (S, L) float32
    sigma: Tensor  # (S, L) float32

    def draw(self, size: int, rng: torch.Generator) -> PathBatch:
        """One point of each of so many paths, drawn with replacement, every other one from goal to start."""
        device = self.ids.device
        rows = torch.randint(len(self.ids), (size,), generator=rng, device=device)
        # What is a near-optimal path one way is one the other way.
        back = torch.rand(size, generator=rng, device=device) < 0.5
        paths, ids = self.paths[rows], self.ids[rows]
        paths = torch.where(back.view(-1, 1, 1), paths.flip(1), paths)
        at = torch.randint(paths.shape[1], (size,), generator=rng, device=device)
        points = paths[torch.arange(size, device=device), at]
        return PathBatch(points, paths[:, 0], paths[:, -1], ids, self.mu[ids], self.sigma[ids])


def equal_paths(dataset: Dataset, points: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """All paths of a data set, resampled to (T, points, d) at equal distances, and their scenarios (T,)."""
    offsets = dataset.arrays.get("path_offsets", np.zeros(1, np.int64))
    sizes = np.diff(offsets)
    if not len(sizes) or sizes.min() < 2:
        raise DatasetError(
            "the data set holds no paths", expected="paths of two points or more", got=str(dataset.folder)
        )
    rows = dataset.arrays["paths"]
    owner = np.asarray(dataset.arrays["path_scenario"])
    if (sizes == points).all():
        return np.asarray(rows).reshape(-1, points, dataset.world.dim), owner
    space = dataset.world.space
    parts = [spread_points(np.asarray(rows[a:b], np.float64), points, space) for a, b in pairwise(offsets)]
    return np.stack(parts).astype(np.float32), owner


class PathGanModule(AdversarialModule):
    """WGAN-GP over points of paths (Algorithm 3: start and goal beside the latent)."""

    samples: PathSamples
    config: PathGanConfig

    def __init__(self, config: PathGanConfig, samples: PathSamples, seed: int, space: JointSpace) -> None:
        super().__init__(seed)
        self.config, self.samples, self.joints = config, samples, Joints(space)
        sizes = Sizes(space, samples.mu.shape[1], config.hidden, config.layers)
        self.net = PathGenerator(sizes, config.noise_dim)
        self.critic = PathCritic(replace(sizes, hidden=config.critic_hidden, layers=config.critic_layers))
        self.set_optimisers(self.net.parameters(), config.learning_rate)

    def generate(self, batch: PathBatch) -> Tensor:
        """A point for each path's latent, start and goal, (b, 1, d) rad."""
        latent = batch.mu + batch.sigma * self.normal(*batch.mu.shape)
        noise = self.normal(len(batch.ids), self.net.noise_dim)
        points: Tensor = self.net(Condition(latent, batch.start, batch.goal), noise)
        return points.unsqueeze(1)

    def values(self, critic: nn.Module, configurations: Tensor, batch: PathBatch) -> Tensor:
        """Critic values (b, 1); it knows the latent's mean, not the draw that the generator got."""
        features = Condition(batch.mu, batch.start, batch.goal).features(self.joints)
        values: Tensor = critic(configurations.squeeze(1), features)
        return values.unsqueeze(1)

    def interpolate(self, real: Tensor, fake: Tensor) -> Tensor:
        """Between each real point and its generated one, the shorter way on circles."""
        return self.joints.interpolate(fake.squeeze(1), real, self.uniform(len(real), 1))


def point_graph(net: PathGenerator, latent_dim: int) -> bytes:
    """ONNX bytes: latent, start, goal and noise to points (m, 1, d) rad."""
    shapes = {"latent": (latent_dim,), "start": (net.joints.dim,), "goal": (net.joints.dim,)}
    rows = tuple(torch.zeros(2, *shape) for shape in (*shapes.values(), (net.noise_dim,)))

    def points(latent: Tensor, start: Tensor, goal: Tensor, noise: Tensor) -> Tensor:
        found: Tensor = net(Condition(latent, start, goal), noise)
        return found.unsqueeze(1)

    names, axes = [*shapes, "noise"], batched("latents", len(rows))
    return exported(Graph(points, net), rows, names, ["samples"], axes)
