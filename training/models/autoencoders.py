"""Variational autoencoders of pictures and of arrays of space, their latents, and a picture's novelty."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import Sensor
from training.config import VaeConfig
from training.models.modules import TrialModule

# Voxels of a picture along a side of a coarse one.
STRIDE = 4
# Of a coarse voxel: nearest surface seen; shares seen free, hidden behind a surface, and out of view.
COARSE = 4
_HALF = 0.5 / 255.0
# Code of the second channel up to which a voxel is behind a surface.
_LAST_BEHIND = 253.5 / 255.0


def coarse(pictures: Tensor) -> Tensor:
    """Pictures (b, 2, X, Y, Z) in [0, 1] to (b, 4, X / 4, Y / 4, Z / 4) in [-1, 1]."""
    near, code = pictures[:, :1], pictures[:, 1:]
    free, out = (code < _HALF).float(), (code > 1.0 - _HALF).float()
    hidden = (code < _LAST_BEHIND).float() - free
    shares = functional.avg_pool3d(torch.cat([free, hidden, out], dim=1), STRIDE)
    return 2.0 * torch.cat([-functional.max_pool3d(-near, STRIDE), shares], dim=1) - 1.0


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


class GridVaeEncoder(nn.Module):
    """Picture to the mean and log variance of its latent.

    Shapes: (b, 2, X, Y, Z) in [0, 1] to (b, L), (b, L).
    """

    def __init__(self, counts: tuple[int, int, int], latent_dim: int, width: int) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv3d(COARSE, width, 3, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv3d(width, 2 * width, 3, stride=2, padding=1),
            nn.LeakyReLU(0.2),
            nn.Flatten(),
        )
        size = 2 * width
        for count in counts:
            size *= _halved(_halved(count // STRIDE))
        self.mean, self.log_variance = nn.Linear(size, latent_dim), nn.Linear(size, latent_dim)
        # As of the encoder of flat pictures.
        nn.init.normal_(self.log_variance.weight, std=1e-3)
        nn.init.constant_(self.log_variance.bias, -3.0)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of the latent."""
        return self.of_shown(coarse(pictures))

    def of_shown(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """The same of what :func:`coarse` made."""
        features = self.features(pictures)
        return self.mean(features), self.log_variance(features).clamp(-8.0, 4.0)


class GridVaeDecoder(nn.Module):
    """Latent to what :func:`coarse` makes of a picture, (b, L) to (b, 4, X / 4, Y / 4, Z / 4)."""

    def __init__(self, counts: tuple[int, int, int], latent_dim: int, width: int) -> None:
        super().__init__()
        sizes = [count // STRIDE for count in counts]
        self.inner = (2 * width, *(_halved(_halved(size)) for size in sizes))
        self.first = nn.Linear(latent_dim, self.inner[0] * self.inner[1] * self.inner[2] * self.inner[3])
        self.layers = nn.Sequential(
            nn.LeakyReLU(0.2),
            nn.Upsample(size=tuple(_halved(size) for size in sizes)),
            nn.Conv3d(2 * width, width, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Upsample(size=tuple(sizes)),
            nn.Conv3d(width, COARSE, 3, padding=1),
            LeakyTanh(),
        )

    def forward(self, latent: Tensor) -> Tensor:
        """The decoded pictures, near [-1, 1]."""
        first: Tensor = self.first(latent)
        decoded: Tensor = self.layers(first.view(-1, *self.inner))
        return decoded


class GridNovelty(nn.Module):
    """The mean squared error of the reconstruction, and of its worst part, two coarse voxels wide.

    Shapes: pictures (b, 2, X, Y, Z) in [0, 1] and latent means (b, L) to (b, 2).
    """

    def __init__(self, decoder: GridVaeDecoder) -> None:
        super().__init__()
        self.decoder, self.part = decoder, nn.AvgPool3d(2, stride=1)

    def forward(self, pictures: Tensor, mu: Tensor) -> Tensor:
        """Both scores."""
        error = (self.decoder(mu) - coarse(pictures)).square().mean(dim=1, keepdim=True)
        worst = self.part(error).amax(dim=(1, 2, 3, 4))
        return torch.stack([error.mean(dim=(1, 2, 3, 4)), worst], dim=1)


def _halved(count: int) -> int:
    return (count + 1) // 2


_SPACE_AXES = 4
# Of pictures that are worked on at once.
_BLOCK, _BLOCK_BYTES = 256, 2**24


def shown(sensor: Sensor, images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What an auto-encoder of a sensor's pictures (n, ...) learns to draw, uint8, channels first."""
    if len(sensor.picture_shape) < _SPACE_AXES:
        return np.ascontiguousarray(np.moveaxis(images, -1, 1))
    found = []
    for rows in blocks(sensor, len(images)):
        near = coarse(torch.from_numpy(sensor.to_network(np.asarray(images[rows]))))
        found.append(((near + 1.0) * 127.5).round().to(torch.uint8).numpy())
    return np.concatenate(found)


def make_encoder(config: VaeConfig, size: Sequence[int]) -> Encoder | GridVaeEncoder:
    """The encoder of pictures that are shown as (channels, ...) of a size."""
    if len(size) < _SPACE_AXES:
        return Encoder(size[-1], config.latent_dim, config.width, config.patches)
    return GridVaeEncoder(_counts(size), config.latent_dim, config.width)


def make_decoder(config: VaeConfig, size: Sequence[int]) -> Decoder | GridVaeDecoder:
    """The decoder to pictures that are shown as (channels, ...) of a size."""
    if len(size) < _SPACE_AXES:
        return Decoder(size[-1], config.latent_dim, config.width)
    return GridVaeDecoder(_counts(size), config.latent_dim, config.width)


def shown_size(sensor: Sensor) -> tuple[int, ...]:
    """The size of what :func:`shown` makes of one picture."""
    *sides, channels = sensor.picture_shape
    if len(sensor.picture_shape) < _SPACE_AXES:
        return (channels, *sides)
    return (COARSE, *(side // STRIDE for side in sides))


def network_size(sensor: Sensor) -> tuple[int, ...]:
    """The size of one picture as networks take it, channels first."""
    *sides, channels = sensor.picture_shape
    return (channels, *sides)


def blocks(sensor: Sensor, count: int) -> list[slice]:
    """So many pictures in parts that are small enough to be worked on at once."""
    size = max(1, min(_BLOCK, _BLOCK_BYTES // int(np.prod(sensor.picture_shape))))
    return [slice(start, start + size) for start in range(0, count, size)]


def encode(
    encoder: nn.Module, sensor: Sensor, images: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and standard deviation (S, L) of the latents of pictures (S, ...)."""
    means, deviations = [], []
    with torch.inference_mode():
        for rows in blocks(sensor, len(images)):
            mu, log_variance = encoder(torch.from_numpy(sensor.to_network(np.asarray(images[rows]))))
            means.append(mu.numpy())
            deviations.append((log_variance / 2.0).exp().numpy())
    return np.concatenate(means), np.concatenate(deviations)


def _counts(size: Sequence[int]) -> tuple[int, int, int]:
    x, y, z = (STRIDE * side for side in size[1:])
    return (x, y, z)


class NoveltyScores(nn.Module):
    """The mean squared error of the whole reconstruction, and of its worst part, an eighth of a side wide.

    The first tells another style of picture, the second one thing too many or out of place.

    Shapes: pictures (b, 3, P, P) in [-1, 1] and latent means (b, L) to (b, 2).
    """

    def __init__(self, decoder: Decoder, pixels: int) -> None:
        super().__init__()
        self.decoder = decoder
        self.part = nn.AvgPool2d(max(1, pixels // 8), stride=max(1, pixels // 24))

    def forward(self, pictures: Tensor, mu: Tensor) -> Tensor:
        """Both scores."""
        error = (self.decoder(mu) - pictures).square().mean(dim=1, keepdim=True)
        worst = self.part(error).amax(dim=(1, 2, 3))
        return torch.stack([error.mean(dim=(1, 2, 3)), worst], dim=1)


def kl_divergence(mu: Tensor, log_variance: Tensor) -> Tensor:
    """KL(N(mu, s^2) | N(0, 1)) = sum(mu^2 + s^2 - log s^2 - 1) / 2 over the latent, (b,) (eq. kl, mended)."""
    return 0.5 * (mu.square() + log_variance.exp() - log_variance - 1.0).sum(dim=-1)


def reconstruction_loss(images: Tensor, decoded: Tensor) -> Tensor:
    """Squared error summed over each picture, (b,)."""
    return (images - decoded).square().flatten(1).sum(dim=-1)


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
        reconstruction = reconstruction_loss(pictures, self.decoder(latent)).mean()
        kl = kl_divergence(mu, log_variance).mean()
        warmup = min(1.0, (self.global_step + 1) / max(1.0, self.config.kl_warmup * self.config.steps))
        loss = reconstruction + self.config.kl_weight * warmup * kl
        self.descend(loss, self.config.gradient_clip)
        self.latest = {
            "vae_loss": loss.detach(),
            "reconstruction_loss": reconstruction.detach(),
            "kl": kl.detach(),
        }
