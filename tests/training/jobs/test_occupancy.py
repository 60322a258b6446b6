"""From the data set to the validity trial's tensors."""

import numpy as np
import pytest
import torch

from cspace.dataset import write_dataset
from cspace.worlds import examples
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.training.models.builders import run, save
from training.clusters.bundling import head_graphs
from training.config import GridConfig, HeadConfig, ValidityConfig
from training.jobs.trials import has_occupancy, head_module, occupancy_samples
from training.models.checkpoint import load_scene_model

HEAD = ValidityConfig()
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


PANDA = examples()["panda"]


def spatial(folder, value, count):
    """Pictures that are one value, without geometry, as of outcomes."""
    rows = PANDA.space.to_float32(PANDA.space.sample_uniform(np.random.default_rng(value), 4))
    return write_dataset(
        folder,
        world=PANDA,
        images=np.full((count, *PANDA.sensor.picture_shape), value, dtype=np.uint8),
        free=[rows[:3]] * count,
        collision=[rows[3:]] * count,
        generator={"by": "test"},
    ).folder


def test_a_head_learns_from_outcomes_as_often_as_they_have_pictures(tmp_path):
    data, outcomes = spatial(tmp_path / "data", 100, 3), spatial(tmp_path / "outcomes", 200, 1)
    grid = GridConfig(width=4, middle=4, deep=4)
    config = HeadConfig(grid=grid, hidden=8, pictures_per_step=1, configurations_per_picture=2, steps=1)
    module = head_module(data, config, torch.empty(0), 0, outcomes)
    assert [float(share) for share in module.shares] == [3.0, 1.0]
    assert [int(one.images[0].max()) for one in module.samples.samples] == [100, 200]
    before = [one.detach().clone() for one in module.parameters()]
    run(module, 1)
    assert any((one != other).any() for one, other in zip(module.parameters(), before, strict=True))
    assert len(head_module(data, config, torch.empty(0), 0).samples.samples) == 1


@pytest.mark.slow
def test_a_scene_model_is_trained_further_and_exported_as_it_became(tmp_path):
    data = spatial(tmp_path / "data", 100, 1)
    config = HeadConfig(grid=GridConfig(), scene_model="shipped", steps=1)
    module = head_module(data, config, torch.empty(0), 0, data)
    shipped = load_scene_model(config.scene_model_file, PANDA)
    for name, value in shipped.state_dict().items():
        assert torch.equal(module.head.model.state_dict()[name], value), name
    with torch.no_grad():
        module.head.model.hazard.bias += 3.0
    checkpoint = save(tmp_path / "final.ckpt", module)
    further, first = (head_graphs(config, PANDA, at) for at in (checkpoint, config.scene_model_file))
    assert further["map"] == first["map"]
    assert further["validity"] != first["validity"]
