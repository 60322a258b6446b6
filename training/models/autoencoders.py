"""Variational autoencoders of pictures and of arrays of space, their latents, and a picture's novelty."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import Sensor
from training.config import VaeConfig
from training.models.checkpoint import trained
from training.models.modules import TrialModule

# Voxels of a picture along a side of a coarse one.
STRIDE = 4
# Of a coarse voxel: nearest surface seen; shares seen free, hidden behind a surface, and out of view.
COARSE = 4
# Axes of an array of space, channels included.
_SPACE_AXES = 4
_HALF = 0.5 / 255.0
# Code of the second channel up to which a voxel is behind a surface.
_LAST_BEHIND = 253.5 / 255.0
# Share of the steps over which the KL term grows; largest norm of the gradient.
_KL_WARMUP, _GRADIENT_CLIP = 0.3, 200.0


def coarse(pictures: Tensor) -> Tensor:
    """Pictures (b, 2, X, Y, Z) in [0, 1] to (b, 4, X / 4, Y / 4, Z / 4) in [-1, 1]."""
    near, code = pictures[:, :1], pictures[:, 1:]
    free, out = (code < _HALF).float(), (code > 1.0 - _HALF).float()
    hidden = (code < _LAST_BEHIND).float() - free
    shares = functional.avg_pool3d(torch.cat([free, hidden, out], dim=1), STRIDE)
    return 2.0 * torch.cat([-functional.max_pool3d(-near, STRIDE), shares], dim=1) - 1.0


def _halved(sides: Sequence[int], times: int) -> tuple[int, ...]:
    return tuple(-(-side // 2**times) for side in sides)


def _convolutions(size: Sequence[int]) -> tuple[type[nn.Conv2d] | type[nn.Conv3d], int]:
    """The layers for what is shown of a picture, (channels, ...), and how many there are."""
    return (nn.Conv3d, 2) if len(size) == _SPACE_AXES else (nn.Conv2d, 3)


class Encoder(nn.Module):
    """Picture to the mean and log variance of its latent.

    A flat picture is cut into patches that share their convolutions (4 in the paper, 1 for none); an array of
    space is made coarse first. ``size`` is that of what is shown, (channels, ...).

    Shapes: (b, 3, P, P) in [-1, 1] or (b, 2, X, Y, Z) in [0, 1] to (b, L), (b, L).
    """

    def __init__(self, size: Sequence[int], latent_dim: int, width: int, patches: int = 1) -> None:
        super().__init__()
        convolution, depth = _convolutions(size)
        self.is_space = convolution is nn.Conv3d
        self.cuts = 1 if self.is_space else {1: 1, 4: 2}[patches]
        widths = [size[0], *(width * 2**k for k in range(depth))]
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [convolution(before, after, 3, stride=2, padding=1), nn.LeakyReLU(0.2)]
        self.features = nn.Sequential(*layers, nn.Flatten())
        sides = _halved([side // self.cuts for side in size[1:]], depth)
        inputs = self.cuts**2 * widths[-1] * math.prod(sides)
        self.mean, self.log_variance = nn.Linear(inputs, latent_dim), nn.Linear(inputs, latent_dim)
        # A log variance that starts near zero blows up; it starts small and flat.
        nn.init.normal_(self.log_variance.weight, std=1e-3)
        nn.init.constant_(self.log_variance.bias, -3.0)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of the latent."""
        return self.of_shown(coarse(pictures) if self.is_space else pictures)

    def of_shown(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """The same of what :func:`shown` made."""
        rows = torch.chunk(pictures, self.cuts, dim=2)
        patches = [patch for row in rows for patch in torch.chunk(row, self.cuts, dim=3)]
        features = torch.cat([self.features(patch) for patch in patches], dim=1)
        return self.mean(features), self.log_variance(features).clamp(-8.0, 4.0)


class LeakyTanh(nn.Module):
    """tanh(x) + x / 20: bounded in effect, with a gradient everywhere."""

    def forward(self, values: Tensor) -> Tensor:
        """The same shape."""
        return torch.tanh(values) + 0.05 * values


class Decoder(nn.Module):
    """Latent (b, L) to what is shown of a picture, by resize-convolutions, which leave no checkerboard.

    Most of a picture is white, and a plain tanh that has once become white everywhere has no gradient that
    leads back (one seed in five ended there), so the last one leaks.
    """

    def __init__(self, size: Sequence[int], latent_dim: int, width: int) -> None:
        super().__init__()
        convolution, depth = _convolutions(size)
        widths = [*(width * 2**k for k in reversed(range(depth))), size[0]]
        self.inner = (widths[0], *_halved(size[1:], depth))
        self.first = nn.Linear(latent_dim, math.prod(self.inner))
        layers: list[nn.Module] = []
        for left, (before, after) in zip(reversed(range(depth)), pairwise(widths), strict=True):
            larger = nn.Upsample(size=_halved(size[1:], left))
            layers += [nn.LeakyReLU(0.2), larger, convolution(before, after, 3, padding=1)]
        self.layers = nn.Sequential(*layers, LeakyTanh())

    def forward(self, latent: Tensor) -> Tensor:
        """The decoded pictures, near [-1, 1]."""
        decoded: Tensor = self.layers(self.first(latent).view(-1, *self.inner))
        return decoded


class NoveltyScores(nn.Module):
    """The mean squared error of the whole reconstruction, and of its worst part.

    The first tells another style of picture, the second one thing too many or out of place. A part is an
    eighth of a side wide, in arrays of space two coarse voxels.

    Shapes: pictures as of :class:`Encoder` and latent means (b, L) to (b, 2).
    """

    def __init__(self, decoder: Decoder, size: Sequence[int]) -> None:
        super().__init__()
        self.decoder, self.is_space, side = decoder, len(size) == _SPACE_AXES, size[-1]
        self.part: nn.Module = nn.AvgPool2d(max(1, side // 8), stride=max(1, side // 24))
        if self.is_space:
            self.part = nn.AvgPool3d(2, stride=1)

    def forward(self, pictures: Tensor, mu: Tensor) -> Tensor:
        """Both scores."""
        real = coarse(pictures) if self.is_space else pictures
        error = (self.decoder(mu) - real).square().mean(dim=1, keepdim=True)
        return torch.stack([error.flatten(1).mean(dim=1), self.part(error).flatten(1).amax(dim=1)], dim=1)


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


def load_encoder(config: VaeConfig, sensor: Sensor, checkpoint: Path) -> Encoder:
    """The encoder of a VAE trial's checkpoint, ready to be asked."""
    sizes = (shown_size(sensor), config.latent_dim, config.width, config.patches)
    return trained(lambda: Encoder(*sizes), checkpoint, "encoder")


def load_scores(config: VaeConfig, sensor: Sensor, checkpoint: Path) -> NoveltyScores:
    """The novelty scores by the decoder of a VAE trial's checkpoint."""
    size = shown_size(sensor)
    decoder = trained(lambda: Decoder(size, config.latent_dim, config.width), checkpoint, "decoder")
    return NoveltyScores(decoder, size).eval()


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
        self.encoder = Encoder(images.shape[1:], config.latent_dim, config.width, config.patches)
        self.decoder = Decoder(images.shape[1:], config.latent_dim, config.width)
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
        warmup = min(1.0, (self.global_step + 1) / max(1.0, _KL_WARMUP * self.config.steps))
        loss = reconstruction + warmup * kl
        self.descend(loss, _GRADIENT_CLIP)
        self.latest = {
            "vae_loss": loss.detach(),
            "reconstruction_loss": reconstruction.detach(),
            "kl": kl.detach(),
        }
