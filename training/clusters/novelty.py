"""The novelty of a bundle: how the decoder's scores lie over pictures that are not new."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cspace.bundle.novelty import quantiles_of
from cspace.dataset import Dataset
from cspace.splits import Split
from cspace.worlds import workshop_of
from training.models.encode import load_encoder
from training.models.pictures.autoencoders import blocks
from training.models.settings import VaeConfig

KNOWN_PICTURES = 400


def known_quantiles(
    config: VaeConfig, checkpoint: Path, scores: nn.Module, dataset: Dataset
) -> tuple[tuple[float, ...], ...]:
    """Quantiles of both scores over pictures of the kind that the VAE was trained on.

    Where the scenarios were generated these are validation scenarios; with data of one's own, of which
    there are no others, they are the pictures of the data set, and the percentiles a little too high.
    """
    images, sensor = known_pictures(dataset), dataset.world.sensor
    encoder = load_encoder(config, sensor, checkpoint)
    found = []
    with torch.inference_mode():
        for rows in blocks(sensor, len(images)):
            pictures = torch.from_numpy(sensor.to_network(images[rows]))
            found.append(scores(pictures, encoder(pictures)[0]).numpy())
    return quantiles_of(np.concatenate(found))


def known_pictures(dataset: Dataset) -> NDArray[np.uint8]:
    """At most 400 pictures (n, P, P, 3)."""
    workshop = workshop_of(dataset.world)
    if dataset.generator_seed is None or workshop.count(Split.VALIDATION) is not None:
        rows = np.linspace(0, dataset.scenario_count - 1, min(KNOWN_PICTURES, dataset.scenario_count))
        return np.array(dataset.images[rows.astype(np.int64)])
    scenes = workshop.scenes(Split.VALIDATION, 0, KNOWN_PICTURES)
    return np.stack([workshop.render(scene) for scene in scenes])
