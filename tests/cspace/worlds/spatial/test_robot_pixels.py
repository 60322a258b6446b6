import numpy as np
import pytest

from cspace.worlds.spatial.camera import DepthCamera, looking, to_mm
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of
from cspace.worlds.spatial.rendering import render_depth
from cspace.worlds.spatial.sensor import GridBox
from cspace.worlds.spatial.visibility import distances_m, observe, self_filter, without_lone

CAMERA = DepthCamera.of_field(40, 32, 70.0, looking((1.0, 0.4, 0.8), (0.0, 0.0, 0.4), 0.2))
WALL = Obstacles((Box(pose_of(make_pose(np.eye(3), (-0.7, 0, 0))), (0.1, 3.0, 3.0)),))


def spheres(rng, count=30):
    return np.column_stack(
        (rng.uniform(-0.3, 0.3, (count, 2)), rng.uniform(0.1, 0.7, count), rng.uniform(0.03, 0.1, count))
    )


def brute_begins_m(camera, arm, slack):
    """By marching along each ray in steps of a millimetre."""
    ways = camera.rays() @ camera.matrix[:3, :3].T
    found = np.full(camera.picture_shape, np.inf)
    for depth in np.arange(3.0, 0.0, -0.001):
        points = camera.matrix[:3, 3] + depth * ways
        gaps = np.linalg.norm(points[..., None, :] - arm[:, :3], axis=-1) - arm[:, 3] - slack
        found[(gaps <= 0.0).any(axis=-1)] = depth
    return found


def test_the_arms_pixels_are_those_whose_rays_meet_it_before_their_reading():
    rng = np.random.default_rng(0)
    arm = spheres(rng, 8)
    begins = brute_begins_m(CAMERA, arm, 0.03)
    depth_mm = rng.integers(200, 2500, CAMERA.picture_shape).astype(np.uint16)
    depth_mm[rng.random(depth_mm.shape) < 0.1] = 0
    kept = self_filter(depth_mm, CAMERA, arm, 0.03)
    sure = np.abs(depth_mm * 1e-3 - begins) > 0.005
    shown = (depth_mm > 0) & (depth_mm * 1e-3 >= begins)
    covered = np.isfinite(kept.front_m)
    assert (covered == shown)[sure].mean() > 0.995, "rays that graze a ball may pass it by a step"
    assert 0.05 < covered.mean() < 0.6
    assert not kept.depth_mm[covered].any()
    np.testing.assert_array_equal(kept.depth_mm[~covered], depth_mm[~covered])
    both = covered & shown
    assert np.quantile(np.abs(kept.front_m[both] - begins[both]), 0.99) < 0.005


def test_no_pixel_of_the_arm_remains():
    arm = spheres(np.random.default_rng(1))
    exact = render_depth(WALL, CAMERA, arm)
    robot = exact != render_depth(WALL, CAMERA)
    kept = self_filter(to_mm(exact), CAMERA, arm)
    assert robot.any()
    assert not (kept.depth_mm[robot] > 0).any()
    assert (kept.depth_mm > 0).mean() > 0.3


def test_parts_beside_and_behind_the_camera_hide_nothing_before_it():
    turn, place = CAMERA.matrix[:3, :3], CAMERA.matrix[:3, 3]
    beside = np.array([(0.06, 0.0, -0.03), (-0.05, 0.03, -0.02)]) @ turn.T + place
    depth_mm = np.full(CAMERA.picture_shape, 900, dtype=np.uint16)
    kept = self_filter(depth_mm, CAMERA, np.column_stack((beside, (0.05, 0.04))), 0.0)
    np.testing.assert_array_equal(kept.depth_mm, depth_mm)


def test_flying_pixels_at_the_arms_edge_are_no_obstacles_and_thin_things_beside_it_are():
    camera = DepthCamera.of_field(64, 64, 60.0, looking((1.2, 0.0, 0.4), (0.0, 0.0, 0.4)))
    arm = np.array([(0.0, 0.0, z, 0.06) for z in np.arange(0.1, 0.8, 0.05)])
    # A rod of two centimetres, two pixels wide, before the wall.
    rod = Obstacles((*WALL.boxes, Box(pose_of(make_pose(np.eye(3), (-0.2, 0.3, 0.4))), (0.01, 0.01, 0.6))))
    exact = render_depth(rod, camera, arm)
    robot = exact != render_depth(rod, camera)
    edge = np.argwhere(np.diff(robot[:, :32].astype(int), axis=1) == 1)[::7]
    flying = exact.copy()
    flying[edge[:, 0], edge[:, 1]] = 0.95
    lonely = (5, 5)
    flying[lonely] = 0.5
    grid = GridBox((-0.3, -0.4, 0.1), 0.025, (32, 32, 32))
    centres = grid.centres_m()
    found, plain = (distances_m(observe(to_mm(depth), camera, grid, arm)) for depth in (flying, exact))
    assert len(edge) >= 4
    at_arm = np.linalg.norm(centres[..., :2], axis=-1) < 0.05
    assert plain[at_arm].min() > 0.1
    np.testing.assert_array_equal(found[at_arm], plain[at_arm])
    at_rod = np.linalg.norm(centres[..., :2] - (-0.2, 0.3), axis=-1) < 0.02
    assert (found[at_rod & (centres[..., 2] > 0.2) & (centres[..., 2] < 0.6)] < 0.03).all()
    # Elsewhere it may be a thin thing seen once.
    kept = self_filter(to_mm(flying), camera, arm)
    away = without_lone(kept.depth_mm * np.float32(1e-3), kept.front_m)
    assert away[lonely] == pytest.approx(0.5)
    assert not away[edge[:, 0], edge[:, 1]].any()


def test_what_stands_before_the_arm_remains():
    arm = np.array([[0.0, 0.0, 0.4, 0.1]])
    depth_mm = np.full(CAMERA.picture_shape, 600, dtype=np.uint16)
    kept = self_filter(depth_mm, CAMERA, arm)
    np.testing.assert_array_equal(kept.depth_mm, depth_mm)
    assert np.isinf(kept.front_m).all()
