"""Latents of the scenarios: every picture through the trained encoder, once, for all later trials."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.world import Sensor
from training.models.checkpoint import trained
from training.models.networks import Encoder
from training.models.settings import VaeConfig

_BLOCK = 256


@dataclass(frozen=True, slots=True)
class Latents:
    """Mean and standard deviation of each picture's latent, (S, L) each."""

    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]

    @classmethod
    def none(cls, scenarios: int, latent_dim: int) -> "Latents":
        """Zeros for ``scenarios`` pictures whose encoder does not exist yet."""
        empty = np.zeros((scenarios, latent_dim), dtype=np.float32)
        return cls(empty, empty)


def load_encoder(config: VaeConfig, pixels: int, checkpoint: Path) -> Encoder:
    """The encoder of a VAE trial's checkpoint, ready to be asked."""
    return trained(
        lambda: Encoder(pixels, config.latent_dim, config.width, config.patches), checkpoint, "encoder"
    )


def encode(encoder: Encoder, sensor: Sensor, images: NDArray[np.uint8]) -> Latents:
    """Latents of (S, ...) pictures of a sensor."""
    means, deviations = [], []
    with torch.inference_mode():
        for start in range(0, len(images), _BLOCK):
            mu, log_variance = encoder(torch.from_numpy(sensor.to_network(images[start : start + _BLOCK])))
            means.append(mu.numpy())
            deviations.append((log_variance / 2.0).exp().numpy())
    return Latents(np.concatenate(means), np.concatenate(deviations))
