"""Statistics of the noise of depth cameras, over many pixels of a wall."""

import numpy as np
import pytest

from cspace.worlds.spatial.camera import DepthCamera, looking
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of, turned
from cspace.worlds.spatial.rendering import (
    NOISE_MODELS,
    DropOut,
    axial_sigma_m,
    beside_jumps,
    disparity,
    holed,
    incidence_rad,
    lateral_sigma_px,
    render_depth,
    stereo,
    structured_light,
)

SIDE = 200
CAMERA = DepthCamera.of_field(SIDE, SIDE, 60.0, looking((0, 0, 0), (1, 0, 0)))
WHOLE = DropOut(at_jumps=0.0, anywhere=0.0)


def wall(depth_m):
    return np.full((SIDE, SIDE), depth_m, dtype=np.float32)


def step(near_m, far_m):
    depth = wall(near_m)
    depth[:, SIDE // 2 :] = far_m
    return depth


def test_sigmas_by_hand():
    np.testing.assert_allclose(axial_sigma_m(np.array([0.4, 1.4]), np.zeros(2)), [0.0012, 0.0031])
    # At 72 degrees the angle is 4/5 of a right one: 16 times the square of what is left.
    steep = axial_sigma_m(np.array(1.0), np.array(0.8 * np.pi / 2)) - axial_sigma_m(
        np.array(1.0), np.array(0.0)
    )
    assert steep == pytest.approx(0.0016)
    assert lateral_sigma_px(np.array(np.pi / 4)) == pytest.approx(0.835)


def test_axial_noise_has_its_sigma():
    for depth_m in (0.6, 1.5, 3.0):
        noisy = structured_light(np.random.default_rng(0), wall(depth_m), CAMERA, WHOLE)
        errors = noisy - depth_m
        assert errors.std() == pytest.approx(0.0012 + 0.0019 * (depth_m - 0.4) ** 2, rel=0.03)
        assert abs(errors.mean()) < 4 * errors.std() / SIDE


def test_lateral_noise_swaps_pixels_at_an_edge_and_makes_no_depth_between():
    noisy = structured_light(np.random.default_rng(0), step(1.0, 2.0), CAMERA, WHOLE)
    near, far = np.abs(noisy - 1.0) < 0.05, np.abs(noisy - 2.0) < 0.05
    assert (near | far).all()
    swapped = near[:, SIDE // 2 :].sum() / SIDE
    # Of a normal draw of 0.8 pixels, rounded: P(draw <= -0.5) for the first pixel behind the edge, and so on.
    assert swapped == pytest.approx(0.266 + 0.030, abs=0.09)


def test_steep_surfaces_are_noisier_and_their_angle_is_told():
    leaning = Obstacles((Box(pose_of(make_pose(turned(np.radians(70.0)), (1.5, 0, 0))), (0.001, 9, 9)),))
    depth = render_depth(leaning, CAMERA, max_range_m=9.0).depth_m
    middle = np.degrees(incidence_rad(depth, CAMERA)[SIDE // 2, SIDE // 2])
    assert middle == pytest.approx(70.0, abs=0.5)
    assert np.degrees(incidence_rad(wall(1.0), CAMERA)[SIDE // 2, SIDE // 2]) < 0.5
    corner = np.degrees(np.arccos(1.0 / np.linalg.norm(CAMERA.rays()[0, 0])))
    assert np.degrees(incidence_rad(wall(1.0), CAMERA)[0, 0]) == pytest.approx(corner, abs=0.1)


def test_disparities_are_whole_eighths_of_a_pixel():
    noisy = disparity(np.random.default_rng(0), wall(2.0), CAMERA, WHOLE)
    eighths = 480.0 * 0.075 * 8 / noisy.astype(np.float64)
    np.testing.assert_allclose(eighths, np.rint(eighths), atol=1e-3)
    # 144 exactly at 2 m: sigma 1/6 leaves it but for draws beyond three sigmas.
    assert (np.rint(eighths) == 144).mean() == pytest.approx(0.9973, abs=0.002)
    coarse = disparity(np.random.default_rng(0), wall(2.005), CAMERA, WHOLE, sigma_parts=0.0)
    np.testing.assert_allclose(coarse, 2.0, atol=1e-6)


def test_stereo_noise_grows_with_the_square_of_the_depth():
    for depth_m in (0.5, 1.0, 2.0):
        noisy = stereo(np.random.default_rng(0), wall(depth_m), CAMERA, WHOLE)
        sigma = depth_m**2 * 0.08 / (424.0 * 0.05)
        assert (noisy - depth_m).std() == pytest.approx(sigma, rel=0.05)
    errors = noisy - depth_m
    beside = np.corrcoef(errors[:, 1:].ravel(), errors[:, :-1].ravel())[0, 1]
    assert beside == pytest.approx(np.exp(-0.25), abs=0.05)
    alone = stereo(np.random.default_rng(0), wall(1.0), CAMERA, WHOLE, smooth_px=0.0) - 1.0
    assert abs(np.corrcoef(alone[:, 1:].ravel(), alone[:, :-1].ravel())[0, 1]) < 0.03


def test_readings_drop_out_beside_jumps():
    depth = step(1.0, 1.2)
    found = beside_jumps(depth, 0.05)
    assert found.sum() == 2 * SIDE
    assert found[:, SIDE // 2 - 1 : SIDE // 2 + 1].all()
    assert not beside_jumps(depth, 0.3).any()
    # A neighbour without a reading is a jump.
    assert beside_jumps(step(1.0, 0.0), 0.05).sum() == SIDE
    lost = DropOut(0.05, 0.4, 0.01).lost(np.random.default_rng(0), depth)
    assert lost[found].mean() == pytest.approx(0.4, abs=0.1)
    assert lost[~found].mean() == pytest.approx(0.01, abs=0.002)


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


def test_holes_are_rectangles_without_a_reading():
    depth = np.full((40, 60), 1.5, dtype=np.float32)
    rng, lost = np.random.default_rng(0), []
    for _ in range(200):
        found = holed(rng, depth)
        assert set(np.unique(found)) <= {0.0, 1.5}
        lost.append(float((found == 0.0).mean()))
    assert min(lost) >= 0.005
    assert 0.15 < np.mean(lost) < 0.45
    assert max(lost) < 1.0
    assert (depth == 1.5).all()
