from types import SimpleNamespace

import numpy as np
import pytest

from cspace.dataset import write_dataset
from cspace.errors import ConfigError
from training.clusters.pipeline import cluster_data
from training.config import CLUSTERS_FILE, TrainConfig

COUNT = 400


def dataset(folder, count=COUNT):
    world = TrainConfig.load("smoke").data.world
    images = np.zeros((1, *world.sensor.picture_shape), dtype=np.uint8)
    free = np.random.default_rng(0).uniform(-3.0, 3.0, (count, 2))
    return write_dataset(folder, world=world, images=images, free=[free], generator={})


def job(folder, *overrides, preset="smoke"):
    folder.mkdir(exist_ok=True)
    return SimpleNamespace(config=TrainConfig.load(preset, overrides), folder=folder)


def test_a_job_that_goes_on_reads_the_clusters_that_it_wrote(tmp_path):
    data, going_on = (
        dataset(tmp_path / "data"),
        job(tmp_path / "job", "gate.cells=6", "gate.points=16", preset="smoke_mixture"),
    )
    first = cluster_data(going_on, data)
    same = cluster_data(going_on, data)
    np.testing.assert_array_equal(first.labels, same.labels)
    np.testing.assert_array_equal(first.cells.labels, same.cells.labels)
    np.testing.assert_array_equal(first.cells.points, same.cells.points)
    path = going_on.folder / CLUSTERS_FILE
    with np.load(path) as kept:
        written = dict(kept)
    # As another machine or release would have cut the same data.
    written["cells"] = np.arange(COUNT) % 6
    np.savez(path, **written)
    again = cluster_data(going_on, data)
    np.testing.assert_array_equal(again.cells.labels, np.arange(COUNT) % 6)
    np.testing.assert_array_equal(again.labels, written["clusters"][np.arange(COUNT) % 6])
    assert not np.array_equal(again.labels, first.labels)


def test_a_job_that_goes_on_with_other_data_is_told(tmp_path):
    going_on = job(tmp_path / "job")
    cluster_data(going_on, dataset(tmp_path / "data"))
    with pytest.raises(ConfigError, match="not those that the job began with"):
        cluster_data(going_on, dataset(tmp_path / "other", COUNT + 1))
