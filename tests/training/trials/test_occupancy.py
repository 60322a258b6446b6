"""From the data set to the validity trial's tensors."""

import numpy as np
import pytest
import torch

from cspace.dataset import write_dataset
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.models.settings import ValidityConfig
from training.trials.arrays import has_occupancy, occupancy_samples

HEAD = ValidityConfig(free_share=0.5)
FREE = [np.full((3, 2), 0.5, dtype=np.float32), np.full((2, 2), 1.0, dtype=np.float32)]


def dataset(folder, collision):
    return write_dataset(
        folder / "data",
        world=PlanarWorld(TWO_LINK, Camera()),
        images=np.stack([np.full((48, 48, 3), value, dtype=np.uint8) for value in (10, 20)]),
        free=FREE,
        generator={"by": "test"},
        collision=collision,
    )


def rows(count):
    return np.full((count, 2), -1.0, dtype=np.float32)


@pytest.mark.parametrize("collision", [None, [rows(0), rows(0)]], ids=["unknown", "none"])
def test_data_without_configurations_in_collision_make_no_head(collision, tmp_path):
    assert not has_occupancy(dataset(tmp_path, collision), HEAD)


def test_samples_belong_to_their_pictures_and_further_pictures_have_none(tmp_path):
    data = dataset(tmp_path, [rows(0), rows(4)])
    assert has_occupancy(data, HEAD)
    samples = occupancy_samples(data, torch.zeros(5, 3, 48, 48, dtype=torch.uint8))
    assert len(samples.images) == 2
    assert samples.scenarios.tolist() == [1]
    _, configurations, labels = samples.draw(1, 2, 2, torch.Generator().manual_seed(0))
    assert torch.equal(configurations[labels > 0.5], torch.ones(2, 2))
    assert torch.equal(configurations[labels < 0.5], -torch.ones(2, 2))
