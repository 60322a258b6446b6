import numpy as np

from cspace.worlds.planar.arm import THREE_LINK
from services.planner.sources.uniform_sampler import UniformSampler
from tests.bundles import picture


def test_uniform_samples_stay_in_the_joint_space_and_follow_the_seed():
    sampler = UniformSampler(THREE_LINK.space)
    first, again, other = (sampler.sample(picture(), 50, seed).samples for seed in (1, 1, 2))
    assert first.dtype == np.float32
    assert first.shape == (50, 3)
    assert (np.abs(first.astype(np.float64)) < np.pi).all()
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
