"""Networks that give one point of a path for each row of random numbers: flow and generator.

All of them take a ``Condition``, with a place along the path or without one, and read the picture through a
``Look``: a function from configurations (m, d) to what the picture shows there, (m, values), or None without
look-ups. No point lies outside the limits of the joint space.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from training.models.networks import Sizes, beside, mlp
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
