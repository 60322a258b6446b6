import numpy as np
import pytest

from cspace.errors import ConfigError
from cspace.space import circles
from training.clusters.clustering import Partition, cluster

SPACE = circles(2)


def two_groups(count=300):
    rng = np.random.default_rng(0)
    near = rng.normal(0.0, 0.2, size=(count, 2))
    across_the_seam = rng.normal(np.pi, 0.2, size=(count, 2))
    wrapped = np.mod(across_the_seam + np.pi, 2 * np.pi) - np.pi
    return np.concatenate([near, wrapped]).astype(np.float32)


def test_a_group_across_the_seam_stays_one_cluster():
    labels = cluster(two_groups(), 2, 100, 0, SPACE).labels
    assert len(set(labels[:300])) == len(set(labels[300:])) == 1
    assert labels[0] != labels[-1]


def test_every_configuration_is_labelled_once():
    result = cluster(two_groups(), 3, 100, 0, SPACE)
    assert sum(result.sizes) == 600
    assert result.centres.shape == (3, 4)


def test_the_same_seed_gives_the_same_clusters():
    first, second = (cluster(two_groups(), 4, 200, 5, SPACE) for _ in range(2))
    np.testing.assert_array_equal(first.labels, second.labels)


def test_three_joints_need_no_other_code():
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-np.pi, np.pi, (200, 3)).astype(np.float32)
    assert cluster(drawn, 2, 200, 0, circles(3)).centres.shape == (2, 6)


def test_more_clusters_than_configurations_are_refused():
    with pytest.raises(ConfigError, match="at least 5"):
        cluster(np.zeros((3, 2), dtype=np.float32), 5, 10, 0, SPACE)


def test_data_that_leave_a_cluster_of_an_earlier_job_empty_are_refused(tmp_path):
    data = two_groups()
    earlier = Partition(cluster(data, 2, 100, 0, SPACE), np.arange(2))
    earlier.save(tmp_path / "clusters.npz")
    again = Partition.load(tmp_path / "clusters.npz", data, SPACE)
    np.testing.assert_array_equal(again.labels, earlier.labels)
    with pytest.raises(ConfigError, match=r"without configurations.*some in each of 2"):
        Partition.load(tmp_path / "clusters.npz", data[:300], SPACE)
