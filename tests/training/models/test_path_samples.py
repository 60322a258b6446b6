"""Batches of paths: points with the ends and the place that belong to them."""

import numpy as np
import pytest
import torch

from cspace.dataset import write_dataset
from cspace.errors import DatasetError
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.training.models.path_builders import POINTS, generator, samples
from training.models.paths import equal_paths


def test_a_point_lies_on_the_path_between_the_ends_that_come_with_it():
    batch = samples().draw(500, generator())
    space = TWO_LINK.space
    way = space.difference(batch.start.numpy(), batch.goal.numpy())
    at = space.difference(batch.start.numpy(), batch.configurations.numpy())
    share = np.sum(at * way, axis=1, keepdims=True) / np.sum(way * way, axis=1, keepdims=True)
    np.testing.assert_allclose(at, share * way, atol=1e-4)
    assert share.min() >= -1e-6
    assert share.max() <= 1.0 + 1e-6
    assert set(batch.ids.tolist()) == {0, 1, 2, 3}


def test_half_of_the_paths_are_walked_backwards():
    one = samples(1)
    batch = one.draw(400, generator())
    forwards = (batch.start == one.paths[0, 0]).all(dim=1)
    assert 0.4 < forwards.float().mean() < 0.6
    assert torch.equal(batch.goal[~forwards], one.paths[0, 0].expand(int((~forwards).sum()), 2))


def dataset_with(tmp_path, paths):
    images = np.zeros((2, 48, 48, 3), np.uint8)
    free = [np.zeros((1, 2)), np.zeros((1, 2))]
    return write_dataset(
        tmp_path / "data",
        world=PlanarWorld(TWO_LINK, Camera()),
        images=images,
        free=free,
        paths=paths,
        generator={},
    )


def test_paths_of_any_length_become_paths_of_equally_many_points(tmp_path):
    bent = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    paths, owner = equal_paths(dataset_with(tmp_path, [(1, bent), (0, bent[:2])]), 5)
    assert owner.tolist() == [1, 0]
    np.testing.assert_allclose(paths[0], [[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1]], atol=1e-6)
    np.testing.assert_allclose(paths[1][:, 0], [0, 0.25, 0.5, 0.75, 1], atol=1e-6)


@pytest.mark.parametrize("paths", [None, [], [(0, np.zeros((1, 2)))]])
def test_data_without_paths_are_refused(tmp_path, paths):
    with pytest.raises(DatasetError):
        equal_paths(dataset_with(tmp_path, paths), POINTS)
