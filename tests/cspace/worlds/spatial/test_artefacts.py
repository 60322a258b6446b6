import numpy as np
import pytest
from numpy.typing import NDArray

from cspace.worlds.spatial.camera import DepthCamera, without_artefacts
from cspace.worlds.spatial.visibility import reduced

HIGH, WIDE = 480, 640
CAMERA = DepthCamera(600.0, 600.0, 320.0, 240.0, WIDE, HIGH)
NEAR, FAR = 800, 1400
SQUARE = (slice(150, 330), slice(200, 440))


def square() -> NDArray[np.uint16]:
    depth = np.full((HIGH, WIDE), FAR, dtype=np.uint16)
    depth[SQUARE] = NEAR
    return depth


def smeared(depth: NDArray[np.uint16], pixels: int) -> NDArray[np.uint16]:
    """With edges that go over into what is behind within so many pixels, as stereo cameras have them."""
    wide = np.pad(depth.astype(np.float64), pixels, mode="edge")
    for axis in (0, 1):
        mean = np.cumsum(wide, axis=axis)
        mean = np.take(mean, range(pixels, mean.shape[axis]), axis) - np.take(
            mean, range(mean.shape[axis] - pixels), axis
        )
        wide = mean / pixels
    return wide[pixels // 2 :, pixels // 2 :][:HIGH, :WIDE].astype(np.uint16)


@pytest.mark.parametrize("pixels", [2, 4, 6])
def test_pixels_between_two_surfaces_are_no_readings(pixels: int) -> None:
    found = without_artefacts(smeared(square(), pixels), CAMERA)
    between = (found > NEAR + 50) & (found < FAR - 50)
    assert between.sum() <= 8
    assert (found == NEAR).sum() > 0.9 * 180 * 240
    assert (found == FAR).sum() > 0.9 * (HIGH * WIDE - 180 * 240)


def test_a_smaller_picture_has_surfaces_alone() -> None:
    found, camera = reduced(smeared(square(), 4), CAMERA)
    assert found.shape == camera.picture_shape == (120, 160)
    read = found[found > 0]
    assert ((np.abs(read.astype(int) - NEAR) < 50) | (np.abs(read.astype(int) - FAR) < 50)).all()


def test_sharp_edges_floors_wires_and_noise_stay() -> None:
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(without_artefacts(square(), CAMERA), square())
    # The ground 0.4 m below, up to 2 m away, where rays meet it at 79 degrees.
    rows = np.arange(HIGH)[:, None] - 240.0
    ground = np.where(rows > 120, 400.0 * 600.0 / np.maximum(rows, 1.0), 0.0) * np.ones((1, WIDE))
    wire = square()
    wire[:, 100] = 1000
    noisy = np.clip(rng.normal(1000.0, 4.0, (HIGH, WIDE)), 1, None)
    for depth, kept in ((ground, 1.0), (wire, 1.0), (noisy, 0.995)):
        picture = depth.astype(np.uint16)
        assert np.mean(without_artefacts(picture, CAMERA)[picture > 0] > 0) >= kept


def test_lone_readings_go_but_not_among_missing_ones() -> None:
    depth = square()
    lone = (np.array([20, 60, 400]), np.array([30, 90, 600]))
    depth[lone] = 500
    assert not without_artefacts(depth, CAMERA)[lone].any()
    rng = np.random.default_rng(0)
    depth = np.where(rng.random((HIGH, WIDE)) < 0.9, 0, smeared(square(), 4)).astype(np.uint16)
    kept = without_artefacts(depth, CAMERA) > 0
    assert kept.sum() > 0.99 * (depth > 0).sum()


def test_missing_readings_take_no_others_with_them() -> None:
    depth = smeared(square(), 4)
    depth[20:400:7, 30:600:11] = 600
    missing = np.random.default_rng(1).random(depth.shape) < 0.3
    fewer = np.where(missing, 0, depth).astype(np.uint16)
    kept, kept_of_fewer = (without_artefacts(one, CAMERA) > 0 for one in (depth, fewer))
    assert not (kept & ~kept_of_fewer & ~missing).any()
