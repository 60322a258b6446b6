"""The validity head: what it is fed, and that it learns to tell free from colliding."""

import numpy as np
import pytest
import torch

from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import PlanarWorld
from tests.scenarios import random_scenarios
from tests.training.models.builders import run
from training.config import ValidityConfig
from training.models.checkpoint import seeded_initialisation
from training.models.validity import OccupancySamples, ValidityModule

TINY = ValidityConfig(hidden=32, pictures_per_step=8, configurations_per_picture=16, steps=60)


def occupancy(scenarios, seed=0):
    """Some scenarios with 60 uniform configurations each, split by the exact checker."""
    rng = np.random.default_rng(seed)
    parts = {True: [], False: []}
    for scenario in scenarios:
        drawn = rng.uniform(-np.pi, np.pi, (60, 2)).astype(np.float32)
        free = CollisionChecker(scenario).valid_batch(drawn)
        for kind, rows in parts.items():
            rows.append(drawn[free == kind])
    arrays = []
    for kind in (True, False):
        offsets = np.cumsum([0, *map(len, parts[kind])])
        arrays += [torch.tensor(np.concatenate(parts[kind])), torch.tensor(offsets)]
    both = [index for index in range(len(scenarios)) if len(parts[True][index]) and len(parts[False][index])]
    images = torch.tensor(np.stack([render(scenario) for scenario in scenarios]).transpose(0, 3, 1, 2).copy())
    return OccupancySamples(images, *arrays, torch.tensor(both))


@pytest.fixture(scope="module")
def samples():
    return occupancy(random_scenarios(Split.TRAIN, 3, 24))


def test_a_batch_holds_so_many_free_and_colliding_configurations_of_its_pictures(samples):
    scenarios = random_scenarios(Split.TRAIN, 3, 24)
    known = {render(scenario).tobytes(): CollisionChecker(scenario) for scenario in scenarios}
    pictures, configurations, labels = samples.draw(10, 5, 3, torch.Generator().manual_seed(0))
    assert pictures.shape == (10, 3, 48, 48)
    assert labels.sum(dim=1).tolist() == [5.0] * 10
    for picture, rows, marks in zip(pictures, configurations, labels, strict=True):
        seen = ((picture + 1.0) * 127.5).round().to(torch.uint8).permute(1, 2, 0).contiguous().numpy()
        assert known[seen.tobytes()].valid_batch(rows.numpy()).tolist() == marks.bool().tolist()


def test_scenarios_without_both_kinds_are_never_drawn(samples):
    only = OccupancySamples(
        samples.images,
        samples.free,
        samples.free_offsets,
        samples.collision,
        samples.collision_offsets,
        samples.scenarios[:1],
    )
    pictures, _, _ = only.draw(6, 1, 1, torch.Generator().manual_seed(0))
    expected = samples.images[samples.scenarios[0]].float() / 127.5 - 1.0
    assert all(torch.equal(picture, expected) for picture in pictures)


def module(samples, config=TINY, seed=0):
    with seeded_initialisation(seed):
        return ValidityModule(config, samples, PlanarWorld(TWO_LINK, Camera()), seed)


def test_it_learns_to_tell_free_from_colliding_in_scenarios_that_it_never_saw(samples):
    trained = run(module(samples), TINY.steps)
    unseen = occupancy(random_scenarios(Split.VALIDATION, 3, 24), seed=1)
    pictures, configurations, labels = unseen.draw(200, 8, 8, torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = trained.head(pictures, configurations) > 0.0
    accuracy = (found == labels.bool()).float().mean()
    assert accuracy > 0.8
    assert set(trained.metrics()) == {"validity_loss", "validity_accuracy"}
