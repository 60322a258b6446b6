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
from training.models.paths import equal_paths, swept


def test_a_point_lies_at_its_place_between_the_ends_that_come_with_it():
    batch = samples().draw(500, generator())
    way = TWO_LINK.space.difference(batch.start.numpy(), batch.goal.numpy())
    wanted = TWO_LINK.space.wrap(batch.start.numpy() + batch.place.numpy() * way)
    np.testing.assert_allclose(TWO_LINK.space.difference(wanted, batch.points.numpy()), 0.0, atol=1e-4)
    assert set(batch.ids.tolist()) == {0, 1, 2, 3}


def test_half_of_the_paths_are_walked_backwards():
    drawn = samples(1).walked(*samples(1).draw_rows(400, generator()))
    first = samples(1).paths[0, 0]
    forwards = (drawn[:, 0] == first).all(dim=1).float().mean()
    assert 0.4 < forwards < 0.6
    assert torch.equal(drawn[0].flip(0)[0], drawn[0][-1])


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


def test_sweeps_rise_within_their_rows_share_and_start_again():
    places = swept(torch.tensor([[0.5], [0.0], [0.25], [0.5], [0.9]]), 2).squeeze(1)
    np.testing.assert_allclose(places, [0.25, 0.5, 0.125, 0.75, 0.45])


def test_fewer_rows_than_a_sweep_cover_the_whole_way():
    np.testing.assert_allclose(swept(torch.tensor([[0.5], [0.5]]), 16).squeeze(1), [0.25, 0.75])
    assert swept(torch.tensor([[0.3]]), 16).item() == pytest.approx(0.3)
