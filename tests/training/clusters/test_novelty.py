"""The known pictures and their quantiles, and that a trained VAE finds strange pictures strange."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cspace.bundle.load import novelty
from cspace.dataset import open_dataset, write_dataset
from cspace.simulator import Split
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Disc
from tests.dataset_content import content
from tests.scenarios import random_scenarios
from tests.training.models.builders import run, save
from training.clusters.calibration import KNOWN_PICTURES, known_pictures, known_quantiles
from training.config import VaeConfig
from training.models.autoencoders import VaeModule, load_encoder, load_scores
from training.models.checkpoint import seeded_initialisation


def checkpoint(folder, config, pictures):
    with seeded_initialisation(0):
        module = VaeModule(config, torch.tensor(pictures.transpose(0, 3, 1, 2).copy()), 0)
    return save(folder / "final.ckpt", run(module, config.steps))


def pictures_of(scenarios):
    return np.stack([render(one) for one in scenarios])


def opened(folder, **changes):
    write_dataset(folder / "data", **content(**changes))
    return open_dataset(folder / "data")


def test_generated_scenarios_are_held_against_validation_scenarios_of_the_same_camera(tmp_path):
    dataset = opened(tmp_path)
    images = known_pictures(dataset)
    assert images.shape == (KNOWN_PICTURES, 16, 16, 3)
    (first,) = random_scenarios(Split.VALIDATION, 0, 1, dataset.world.body)
    np.testing.assert_array_equal(images[0], render(replace(first, camera=dataset.world.sensor)))


def test_data_of_ones_own_are_held_against_their_own_pictures(tmp_path):
    dataset = opened(tmp_path, generator={"from": "elsewhere"})
    np.testing.assert_array_equal(known_pictures(dataset), dataset.images)


@pytest.mark.slow
def test_a_trained_vae_finds_strange_pictures_strange(tmp_path):
    config = VaeConfig(steps=150)
    seen = random_scenarios(Split.TRAIN, 0, 1000)
    folder = checkpoint(tmp_path, config, pictures_of(seen))
    dataset = opened(tmp_path, world=seen[0].world, images=pictures_of(seen[:3]), extra_images=None)
    scores, encoder = (
        load_scores(config, dataset.world.sensor, folder),
        load_encoder(config, dataset.world.sensor, folder),
    )
    quantiles = known_quantiles(config, folder, scores, dataset)

    def found(images):
        pictures = torch.from_numpy(Camera().to_network(images))
        with torch.inference_mode():
            rows = scores(pictures, encoder(pictures)[0]).numpy()
        return np.array([novelty(row, quantiles) for row in rows])

    fresh = random_scenarios(Split.VALIDATION, 3, 60)
    crowd = [
        replace(one, discs=one.discs + tuple(Disc(x, -3.5, 0.8) for x in (-3.0, 0.0, 3.0))) for one in fresh
    ]
    ordinary = found(pictures_of(fresh))
    assert np.mean(ordinary > 0.95) < 0.2
    for strange in (pictures_of(crowd), 255 - pictures_of(fresh)):
        assert np.mean(found(strange) > 0.95) > 0.8
