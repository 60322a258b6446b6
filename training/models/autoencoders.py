"""Variational autoencoders of pictures and of arrays of space, their latents, and a picture's novelty."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import Sensor
from training.models.networks import Decoder, Encoder, LeakyTanh
from training.models.settings import VaeConfig

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
