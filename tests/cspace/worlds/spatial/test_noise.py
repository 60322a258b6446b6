"""Statistics of the noise of depth cameras, over many pixels of a wall."""

import numpy as np
import pytest

from cspace.worlds.spatial.camera import DepthCamera, looking
from cspace.worlds.spatial.rendering import (
    NOISE_MODELS,
    stereo,
    structured_light,
)

SIDE = 200
CAMERA = DepthCamera.of_field(SIDE, SIDE, 60.0, looking((0, 0, 0), (1, 0, 0)))


def wall(depth_m):
    return np.full((SIDE, SIDE), depth_m, dtype=np.float32)


def test_axial_noise_has_its_sigma():
    for depth_m in (0.6, 1.5, 3.0):
        noisy = structured_light(np.random.default_rng(0), wall(depth_m), CAMERA)
        errors = (noisy - depth_m)[noisy > 0.0]
        assert errors.std() == pytest.approx(0.0012 + 0.0019 * (depth_m - 0.4) ** 2, rel=0.03)
        assert abs(errors.mean()) < 4 * errors.std() / SIDE


def test_stereo_noise_grows_with_the_square_of_the_depth():
    for depth_m in (0.5, 1.0, 2.0):
        noisy = stereo(np.random.default_rng(0), wall(depth_m), CAMERA)
        sigma = depth_m**2 * 0.08 / (424.0 * 0.05)
        errors = np.where(noisy > 0.0, noisy - depth_m, 0.0)
        assert errors.std() == pytest.approx(sigma, rel=0.05)
    beside = np.corrcoef(errors[:, 1:].ravel(), errors[:, :-1].ravel())[0, 1]
    assert beside == pytest.approx(np.exp(-0.25), abs=0.05)


@pytest.mark.parametrize("model", NOISE_MODELS.values(), ids=NOISE_MODELS)
def test_noise_is_seeded_and_reads_nothing_where_nothing_is(model):
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.3, 3.0, (SIDE, SIDE)).astype(np.float32)
    depth[40:90] = 0.0
    first, again, other = (model(np.random.default_rng(seed), depth, CAMERA) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.dtype == np.float32
    assert np.isfinite(first).all()
    assert (first >= 0.0).all()
    assert not first[50:80].any()
