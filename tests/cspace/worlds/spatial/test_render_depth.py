"""The ray caster against marching along each ray by distances, which knows nothing of rays and shapes."""

import numpy as np
import pytest

from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.camera import DepthCamera, looking
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of, turned
from cspace.worlds.spatial.rendering import render_depth

SIDE, FAR_M = 24, 3.0


def marched(obstacles, camera, spheres):
    """Sphere tracing: (H, W) depths and which are of the robot."""
    rays = camera.rays().reshape(-1, 3)
    lengths, pose = np.linalg.norm(rays, axis=1), camera.matrix
    ways = rays @ pose[:3, :3].T
    depth = np.zeros(len(rays))
    for _ in range(3000):
        points = pose[:3, 3] + depth[:, None] * ways
        to_robot = np.full(len(rays), np.inf)
        for sphere in spheres:
            to_robot = np.minimum(to_robot, np.linalg.norm(points - sphere[:3], axis=1) - sphere[3])
        to_scene = distance_m(obstacles, points)
        depth = np.minimum(depth + np.minimum(to_robot, to_scene) / lengths, 2.0 * FAR_M)
    seen = depth < FAR_M
    return np.where(seen, depth, 0).reshape(SIDE, SIDE), (seen & (to_robot < to_scene)).reshape(SIDE, SIDE)


def crowd(rng):
    shapes = []
    for kind in range(10):
        turn = turned(*rng.uniform(-3, 3, 3)) if kind < 8 else np.eye(3)
        pose = pose_of(make_pose(turn, rng.uniform(-0.6, 0.6, 3)))
        sizes = rng.uniform(0.02, 0.3, 3)
        shapes.append(Box(pose, tuple(sizes)) if kind % 2 else Cylinder(pose, *sizes[:2]))
    spheres = np.column_stack((rng.uniform(-0.6, 0.6, (6, 3)), rng.uniform(0.03, 0.15, 6)))
    return Obstacles.of(shapes), spheres


@pytest.mark.parametrize("seed", range(2))
def test_depths_are_those_of_marching_along_the_rays(seed):
    rng = np.random.default_rng(seed)
    obstacles, spheres = crowd(rng)
    # Some cameras are amid the shapes, which are then partly behind them.
    away = 1.6 if seed % 2 else 0.5
    place = rng.normal(size=3)
    place *= away / np.linalg.norm(place)
    while distance_m(obstacles, place) < 0.02 or (np.linalg.norm(spheres[:, :3] - place, axis=1) < 0.2).any():
        place += rng.normal(size=3) * 0.1
    pose = looking(place, rng.normal(size=3) * 0.1, rng.uniform(-3, 3))
    camera = DepthCamera(20.0, 24.0, 10.3, 12.9, SIDE, SIDE, pose_of(pose))
    depth, robot = marched(obstacles, camera, spheres)
    found = render_depth(obstacles, camera, spheres, FAR_M)
    assert (depth > 0).mean() > 0.1
    # Rays that graze an edge may pass it by a rounding.
    agree = np.abs(found - depth) < 2e-3
    assert agree.mean() >= 0.99
    with_robot = found != render_depth(obstacles, camera, max_range_m=FAR_M)
    assert (with_robot == robot)[agree].mean() >= 0.99
    assert found.dtype == np.float32


def test_the_robot_is_told_where_it_is_in_front():
    camera = DepthCamera.of_field(33, 33, 60.0, looking((0, 0, 0), (1, 0, 0)))
    wall = Obstacles((Box(pose_of(make_pose(np.eye(3), (2.0, 1.0, 0))), (0.1, 1.0, 2.0)),))
    behind, before = ((3.0, 0.5, 0.0, 0.2),), ((1.0, 0.0, 0.0, 0.2),)
    empty = render_depth(wall, camera)
    np.testing.assert_array_equal(render_depth(wall, camera, behind), empty)
    found = render_depth(wall, camera, before)
    assert found[16, 16] == pytest.approx(0.8)
    assert found[0, 0] == empty[0, 0]
    assert not render_depth(wall, camera, before, 0.5).any(), "out of range is no reading"
