"""The networks: encoder and decoder of the pictures, generators, critics. Pure torch modules."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from cspace.space import JointSpace
from training.models.joints import Joints


def mlp(inputs: int, hidden: int, layers: int, outputs: int) -> nn.Sequential:
    """A plain perceptron with ``layers`` hidden layers."""
    sizes = [inputs] + [hidden] * layers
    blocks: list[nn.Module] = []
    for before, after in pairwise(sizes):
        blocks += [nn.Linear(before, after), nn.LeakyReLU(0.2)]
    return nn.Sequential(*blocks, nn.Linear(sizes[-1], outputs))


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


def near_zero(last: nn.Module) -> None:
    """Let a perceptron's last layer start near zero."""
    assert isinstance(last, nn.Linear)  # noqa: S101 - for the type checker
    nn.init.normal_(last.weight, std=1e-2)
    nn.init.zeros_(last.bias)


class Encoder(nn.Module):
    """Picture to the mean and log variance of its latent.

    The picture is cut into patches that share their convolutions (4 in the paper, 1 for none).

    Shapes: (b, 3, P, P) in [-1, 1] to (b, L), (b, L).
    """

    def __init__(self, pixels: int, latent_dim: int, width: int, patches: int = 4) -> None:
        super().__init__()
        self.cuts = {1: 1, 4: 2}[patches]
        side = pixels // self.cuts // 8
        self.features = nn.Sequential(
            nn.Conv2d(3, width, 3, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv2d(width, 2 * width, 3, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv2d(2 * width, 4 * width, 3, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Flatten(),
        )
        self.mean = nn.Linear(patches * 4 * width * side * side, latent_dim)
        self.log_variance = nn.Linear(patches * 4 * width * side * side, latent_dim)
        # A log variance that starts near zero blows up; it starts small and flat.
        nn.init.normal_(self.log_variance.weight, std=1e-3)
        nn.init.constant_(self.log_variance.bias, -3.0)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of the latent."""
        features = torch.cat([self.features(patch) for patch in self._patches(images)], dim=1)
        return self.mean(features), self.log_variance(features).clamp(-8.0, 4.0)

    def of_shown(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """The same: the decoder draws whole pictures."""
        found: tuple[Tensor, Tensor] = self(images)
        return found

    def _patches(self, images: Tensor) -> list[Tensor]:
        rows = torch.chunk(images, self.cuts, dim=2)
        return [patch for row in rows for patch in torch.chunk(row, self.cuts, dim=3)]


class LeakyTanh(nn.Module):
    """tanh(x) + x / 20: bounded in effect, with a gradient everywhere."""

    def forward(self, values: Tensor) -> Tensor:
        """The same shape."""
        return torch.tanh(values) + 0.05 * values


class Decoder(nn.Module):
    """Latent to picture by resize-convolutions, which leave no checkerboard: (b, L) to (b, 3, P, P).

    Most of a picture is white, and a plain tanh that has once become white everywhere has no gradient that
    leads back (one seed in five ended there), so the last one leaks.
    """

    def __init__(self, pixels: int, latent_dim: int, width: int) -> None:
        super().__init__()
        self.side = pixels // 8
        self.width = width
        self.first = nn.Linear(latent_dim, 4 * width * self.side * self.side)
        self.layers = nn.Sequential(
            nn.LeakyReLU(0.2),
            nn.Upsample(scale_factor=2),
            nn.Conv2d(4 * width, 2 * width, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Upsample(scale_factor=2),
            nn.Conv2d(2 * width, width, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Upsample(scale_factor=2),
            nn.Conv2d(width, 3, 3, padding=1),
            LeakyTanh(),
        )

    def forward(self, latent: Tensor) -> Tensor:
        """The decoded pictures, near [-1, 1]."""
        first: Tensor = self.first(latent)
        decoded: Tensor = self.layers(first.view(-1, 4 * self.width, self.side, self.side))
        return decoded


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
        step: Tensor = self.residual(generator_inputs(self.joints, latent, base, noise, seen))
        return self.joints.fold(base + step).unsqueeze(1)


def generator_inputs(
    joints: Joints, latent: Tensor, base: Tensor, noise: Tensor, seen: Tensor | None
) -> Tensor:
    """What the perceptron of a torus generator gets, side by side."""
    return beside([latent, joints.features(base), noise], seen)


class MeansGenerator(nn.Module):
    """The paper's generator: z to K means, samples N(mean, sigma^2) on standardised angles (Algorithm 1).

    Shapes: latent (m, L), noise (m, K, d) to (m, K, d) rad.
    """

    mean_rad: Tensor
    std_rad: Tensor

    def __init__(self, sizes: Sizes, means: int, sigma: float, scale: tuple[Tensor, Tensor]) -> None:
        super().__init__()
        self.joints, self.means, self.sigma = Joints(sizes.space), means, sigma
        self.net = sizes.mlp(sizes.latent_dim, means * sizes.space.dim)
        self.register_buffer("mean_rad", scale[0])
        self.register_buffer("std_rad", scale[1])

    def forward(self, latent: Tensor, noise: Tensor) -> Tensor:
        """K configurations for each latent."""
        standardised = self.net(latent).view(-1, self.means, self.joints.dim) + self.sigma * noise
        return self.joints.fold(standardised * self.std_rad + self.mean_rad)


class Critic(nn.Module):
    """f(theta | scenario), conditioned on the latent or by projection on an embedding of the scenario's id.

    ``scenarios`` is the number of ids for the projection (Miyato and Koyama 2018), or None for the
    latent; ``features`` is "torus" or "standardised".

    Shapes: configurations (b, d) rad, condition (b, L) float or (b,) ids, seen (b, looked_up) to (b,).
    """

    mean_rad: Tensor
    std_rad: Tensor

    def __init__(
        self,
        sizes: Sizes,
        *,
        scenarios: int | None,
        features: str,
        scale: tuple[Tensor, Tensor],
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
