"""Auto-encoders by the shape of pictures: flat ones, and arrays of space."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.world import Sensor
from training.models.networks import Decoder, Encoder
from training.models.pictures.space_autoencoder import COARSE, STRIDE, GridVaeDecoder, GridVaeEncoder, coarse
from training.models.settings import VaeConfig

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
