import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.files import read_object
from cspace.worlds.spatial.camera import DepthCamera, looking
from cspace.worlds.spatial.poses import HERE, pose_of

POSE = looking((1.0, -0.8, 1.1), (0.4, 0.1, 0.3), 0.2)
CAMERA = DepthCamera(120.0, 110.0, 30.2, 21.7, 64, 48, pose_of(POSE))


def test_depths_become_points_that_project_to_their_pixels_again():
    depth = np.random.default_rng(0).uniform(0.3, 3.0, CAMERA.picture_shape)
    projected = CAMERA.project(CAMERA.points_m(depth))
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    np.testing.assert_allclose(projected[..., 0], columns, atol=1e-9)
    np.testing.assert_allclose(projected[..., 1], rows, atol=1e-9)
    np.testing.assert_allclose(projected[..., 2], depth, atol=1e-12)
    assert CAMERA.shows(projected).all()


def test_one_pixel_by_hand():
    """Focal length 100, principal point (8, 8): column 18, row 3 at 2 m is right by 0.2, up by 0.1."""
    camera = DepthCamera(100.0, 100.0, 8.0, 8.0, 20, 20, pose_of(looking((0, 0, 1), (5, 0, 1))))
    depth = np.zeros((20, 20))
    depth[3, 18] = 2.0
    points = camera.points_m(depth)
    np.testing.assert_allclose(points[3, 18], (2.0, -0.2, 1.1), atol=1e-12)
    assert np.isnan(np.delete(points.reshape(-1, 3), 3 * 20 + 18, axis=0)).all()


def test_points_behind_or_beside_the_picture_are_not_shown():
    ahead, place = POSE[:3, 2], POSE[:3, 3]
    projected = CAMERA.project([place - ahead, place + ahead, place + ahead + 5.0 * POSE[:3, 0]])
    assert np.isnan(projected[0, :2]).all()
    assert projected[0, 2] == pytest.approx(-1.0)
    assert CAMERA.shows(projected).tolist() == [False, True, False]


def test_a_camera_that_looks_at_a_point_has_it_in_the_middle_and_level_rows():
    pose = looking((1.0, 2.0, 3.0), (0.2, 0.4, 0.1))
    camera = DepthCamera.of_field(65, 65, 60.0, pose)
    np.testing.assert_allclose(camera.project((0.2, 0.4, 0.1))[:2], (32.0, 32.0), atol=1e-9)
    assert pose[2, 0] == pytest.approx(0.0)
    assert pose[2, 1] < 0.0, "down in the picture is down"
    for straight in ((1.0, 2.0, 0.0), (1.0, 2.0, 9.0)):
        DepthCamera.of_field(65, 65, 60.0, looking((1.0, 2.0, 3.0), straight))
    with pytest.raises(ScenarioError):
        looking((1, 2, 3), (1, 2, 3))


def test_the_field_of_view_is_that_of_the_pictures_outer_edges():
    camera = DepthCamera.of_field(100, 60, 90.0, np.eye(4))
    assert camera.project((1.0, 0.0, 1.0))[0] == pytest.approx(99.5)
    assert camera.project((-1.0, 0.0, 1.0))[0] == pytest.approx(-0.5)


def test_a_resized_picture_shows_points_at_the_same_share_of_its_width():
    points = CAMERA.points_m(np.full(CAMERA.picture_shape, 1.5)).reshape(-1, 3)
    small = CAMERA.resized(32, 16)
    np.testing.assert_allclose(
        (small.project(points)[:, :2] + 0.5) / (32, 16),
        (CAMERA.project(points)[:, :2] + 0.5) / (64, 48),
        atol=1e-12,
    )


def test_a_camera_comes_back_from_json_as_it_was():
    def read(values):
        return read_object(DepthCamera, json.loads(json.dumps(values)), "the camera", ScenarioError)

    assert read(CAMERA.to_dict()) == CAMERA
    whole = replace(CAMERA, fx=100, cx=30, pose=[[int(value) for value in row] for row in HERE])
    assert read(whole.to_dict()) == whole
    with pytest.raises(ScenarioError):
        read(CAMERA.to_dict() | {"skew": 0.0})
