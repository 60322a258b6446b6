import numpy as np

from cspace.space import circles
from training.clusters.clustering import cluster

SPACE = circles(2)


def two_groups(count=300):
    rng = np.random.default_rng(0)
    near = rng.normal(0.0, 0.2, size=(count, 2))
    across_the_seam = rng.normal(np.pi, 0.2, size=(count, 2))
    wrapped = np.mod(across_the_seam + np.pi, 2 * np.pi) - np.pi
    return np.concatenate([near, wrapped]).astype(np.float32)


def test_a_group_across_the_seam_stays_one_cluster_and_the_same_seed_gives_the_same():
    labels = cluster(two_groups(), 2, 0, SPACE).labels
    np.testing.assert_array_equal(labels, cluster(two_groups(), 2, 0, SPACE).labels)
    assert len(set(labels[:300])) == len(set(labels[300:])) == 1
    assert labels[0] != labels[-1]
