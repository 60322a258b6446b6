"""Latents of the scenarios: every picture through the trained encoder, once, for all later trials."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cspace.world import Sensor
from training.models.checkpoint import trained
from training.models.networks import Encoder
from training.models.pictures.autoencoders import blocks, make_decoder, make_encoder, shown_size
from training.models.pictures.novelty import NoveltyScores
from training.models.pictures.space_autoencoder import GridNovelty, GridVaeDecoder, GridVaeEncoder
from training.models.settings import VaeConfig


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


def load_encoder(config: VaeConfig, sensor: Sensor, checkpoint: Path) -> Encoder | GridVaeEncoder:
    """The encoder of a VAE trial's checkpoint, ready to be asked."""
    return trained(lambda: make_encoder(config, shown_size(sensor)), checkpoint, "encoder")


def load_scores(config: VaeConfig, sensor: Sensor, checkpoint: Path) -> nn.Module:
    """The novelty scores by the decoder of a VAE trial's checkpoint."""
    decoder = trained(lambda: make_decoder(config, shown_size(sensor)), checkpoint, "decoder")
    if isinstance(decoder, GridVaeDecoder):
        return GridNovelty(decoder).eval()
    return NoveltyScores(decoder, sensor.pixels).eval()


def encode(encoder: nn.Module, sensor: Sensor, images: NDArray[np.uint8]) -> Latents:
    """Latents of (S, ...) pictures of a sensor."""
    means, deviations = [], []
    with torch.inference_mode():
        for rows in blocks(sensor, len(images)):
            mu, log_variance = encoder(torch.from_numpy(sensor.to_network(np.asarray(images[rows]))))
            means.append(mu.numpy())
            deviations.append((log_variance / 2.0).exp().numpy())
    return Latents(np.concatenate(means), np.concatenate(deviations))
