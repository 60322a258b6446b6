"""Networks that give one point of a path for each row of random numbers: flow, VAE decoder, generator.

All of them take a ``Condition``, and read the picture through a ``Look``:
a function from configurations (m, d) to what the picture shows there, (m, values), or None without look-ups.
``space`` is the joint space of each, None for circles alone; no point lies outside its limits.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from cspace.space import JointSpace
from training.models.networks import mlp
from training.models.paths.condition import PLACE_FEATURES, Condition, condition_size, place_features
from training.models.space.joints import Joints

# Power by which the steps of a flow become shorter towards its end, where the velocity is sharp.
FINER = 1.5

Look = Callable[[Tensor], Tensor | None]


def blind(configurations: Tensor) -> None:
    """No look-ups."""
    del configurations


class PathFlow(nn.Module):
    """Velocity from a uniform draw on the torus to a point of the path, and the way along it.

    Shapes: at (m, d) rad, time (m, 1), features (m, F), seen (m, values) or None to (m, d) rad.
    """

    def __init__(
        self,
        dim: int,
        latent_dim: int,
        hidden: int,
        layers: int,
        evaluations: int,
        looked_up: int,
        *,
        place: bool,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__()
        self.joints = Joints.of(space, dim)
        inputs = _seen_size(self.joints, latent_dim, place=place) + PLACE_FEATURES + looked_up
        self.dim, self.evaluations, self.noise_dim = dim, evaluations, dim
        self.net = mlp(inputs, hidden, layers, dim)

    def velocity(self, at: Tensor, time: Tensor, features: Tensor, seen: Tensor | None) -> Tensor:
        """Where a point moves, rad in a unit of time."""
        parts = [features, self.joints.features(at), place_features(time), *([] if seen is None else [seen])]
        moved: Tensor = self.net(torch.cat(parts, dim=1))
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


class PathDecoder(nn.Module):
    """A code to a point, as an embedding: code (m, k), condition to (m, d) rad."""

    def __init__(
        self,
        dim: int,
        latent_dim: int,
        hidden: int,
        layers: int,
        code_dim: int,
        looked_up: int,
        *,
        place: bool,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__()
        self.dim, self.noise_dim, self.joints = dim, code_dim, Joints.of(space, dim)
        inputs = _condition_size(self.joints, latent_dim, place=place) + code_dim + looked_up
        self.net = mlp(inputs, hidden, layers, self.joints.embedded_size)

    def embedded(self, condition: Condition, code: Tensor) -> Tensor:
        """Cosines, then sines, of any length, then places within limits; (m, e)."""
        values: Tensor = self.net(torch.cat([condition.features(self.joints), code], dim=1))
        return values

    def forward(self, condition: Condition, noise: Tensor, look: Look) -> Tensor:
        """Points (m, d) rad; it reads no picture."""
        del look
        return self.joints.unembed(self.embedded(condition, noise))


class PathRecogniser(nn.Module):
    """A point and its condition to mean and log variance of its code, (m, d) rad to (m, k) each."""

    def __init__(
        self,
        dim: int,
        latent_dim: int,
        hidden: int,
        layers: int,
        code_dim: int,
        *,
        place: bool,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__()
        self.joints = Joints.of(space, dim)
        self.net = mlp(_seen_size(self.joints, latent_dim, place=place), hidden, layers, 2 * code_dim)

    def forward(self, condition: Condition, points: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance."""
        seen = torch.cat([condition.features(self.joints), self.joints.features(points)], dim=1)
        mean, log_variance = self.net(seen).chunk(2, dim=1)
        return mean, log_variance.clamp(-8.0, 4.0)


class RefiningGenerator(nn.Module):
    """A point from the noise, moved a few times, each time with a look at the picture where it is.

    Shapes: noise (m, n), the first d of which place the base on the torus, to (m, d) rad.
    """

    def __init__(
        self,
        dim: int,
        latent_dim: int,
        hidden: int,
        layers: int,
        noise_dim: int,
        refinements: int,
        looked_up: int,
        *,
        place: bool,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__()
        self.dim, self.noise_dim, self.joints = dim, dim + noise_dim, Joints.of(space, dim)
        inputs = _seen_size(self.joints, latent_dim, place=place) + noise_dim + looked_up
        self.moves = nn.ModuleList(mlp(inputs, hidden, layers, dim) for _ in range(refinements))
        for move in self.moves:
            last = move[-1]  # type: ignore[index]
            nn.init.normal_(last.weight, std=1e-2)
            nn.init.zeros_(last.bias)

    def forward(self, condition: Condition, noise: Tensor, look: Look) -> Tensor:
        """Points (m, d) rad."""
        # Standard normal noise, so that all generators draw alike; erf spreads it evenly over the torus.
        at = self.joints.from_torus(torch.pi * torch.erf(noise[:, : self.dim] / 2.0**0.5))
        rest, features = noise[:, self.dim :], condition.features(self.joints)
        for move in self.moves:
            seen = look(at)
            parts = [features, self.joints.features(at), rest, *([] if seen is None else [seen])]
            at = self.joints.fold(at + move(torch.cat(parts, dim=1)))
        return at


class PathCritic(nn.Module):
    """f(point | condition): points (m, d) rad, features (m, F), seen (m, values) or None to (m,)."""

    def __init__(
        self,
        dim: int,
        latent_dim: int,
        hidden: int,
        layers: int,
        looked_up: int,
        *,
        place: bool,
        space: JointSpace | None = None,
    ) -> None:
        super().__init__()
        self.joints = Joints.of(space, dim)
        inputs = _condition_size(self.joints, latent_dim, place=place) + self.joints.pair_features_size
        self.net = mlp(inputs + looked_up, hidden, layers, 1)

    def forward(self, points: Tensor, features: Tensor, seen: Tensor | None) -> Tensor:
        """The critic's value."""
        parts = [features, self.joints.pair_features(points), *([] if seen is None else [seen])]
        values: Tensor = self.net(torch.cat(parts, dim=1)).squeeze(1)
        return values


def _condition_size(joints: Joints, latent_dim: int, *, place: bool) -> int:
    return condition_size(latent_dim, joints.dim, place=place, limits=joints.limits)


def _seen_size(joints: Joints, latent_dim: int, *, place: bool) -> int:
    """Of a condition with a configuration beside it."""
    return _condition_size(joints, latent_dim, place=place) + joints.features_size
