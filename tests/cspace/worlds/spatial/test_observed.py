import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.camera import DepthCamera, looking, to_mm
from cspace.worlds.spatial.distance_field import TRUNCATION_M
from cspace.worlds.spatial.furniture import FAMILIES, SpatialScenes
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of, turned
from cspace.worlds.spatial.rendering import render_depth
from cspace.worlds.spatial.scenes import draw_cameras, draw_layout
from cspace.worlds.spatial.sensor import (
    BEHIND_STEP_M,
    FREE,
    MOST_BEHIND,
    NO_READING,
    OUT_OF_VIEW,
    CameraViews,
    GridBox,
    grid_of,
)
from cspace.worlds.spatial.visibility import (
    FREE_MARGIN_M,
    SLACK_M,
    distances_m,
    fused,
    lookup,
    observe,
)
from tests.cspace.worlds.spatial.test_robots import PANDA, READY

SPHERES = PANDA.spheres_at(READY[0])
GRID = GridBox((-0.4, -0.4, 0.0), 0.025, (32, 32, 32))
CENTRES = GRID.centres_m()
ABOVE = DepthCamera.of_field(96, 96, 60.0, looking((0.01, 0.02, 1.5), (0.01, 0.02, 0.0)))
PLANE_M = 0.31


def slab(top_m, half_m=(3.0, 3.0), tilt=0.0):
    """A board of 5 cm whose upper face goes through (0, 0, top)."""
    turn = turned(0.3, tilt)
    pose = make_pose(turn, np.array((0.0, 0.0, top_m)) - 0.025 * turn[:, 2])
    return Obstacles((Box(pose_of(pose), (*half_m, 0.025)),))


def seen(obstacles, *cameras, grid=GRID, spheres=None):
    pictures = [to_mm(render_depth(obstacles, camera, spheres)) for camera in cameras]
    return fused([observe(*one, grid, spheres) for one in zip(pictures, cameras, strict=True)])


@pytest.mark.parametrize("tilt_deg", [40.0, 65.0])
def test_a_plane_seen_at_a_slant_has_no_gaps_between_pixels(tilt_deg):
    obstacles = slab(0.4, tilt=np.radians(tilt_deg))
    pose = np.array(obstacles.boxes[0].pose)
    height = (CENTRES - (0.0, 0.0, 0.4)) @ pose[:3, 2]
    foot = CENTRES - height[..., None] * pose[:3, 2]
    within = (np.abs(foot - (0.0, 0.0, 0.4)) < (0.3, 0.3, 0.3)).all(axis=-1)
    near = (np.abs(height) < TRUNCATION_M - 0.01) & within & (height > -0.02)
    error = distances_m(seen(obstacles, ABOVE))[near] - np.abs(height[near])
    assert near.sum() > 1000
    assert np.abs(error).max() < 0.007


def test_before_a_plane_is_free_and_behind_it_unseen_and_how_deep():
    found = seen(slab(PLANE_M), ABOVE)
    projected = ABOVE.project(CENTRES)
    shown = ABOVE.shows(projected)
    code, height = found[..., 1], CENTRES[..., 2] - PLANE_M
    assert (code[~shown] == OUT_OF_VIEW).all()
    assert (code[shown & (height > FREE_MARGIN_M + 0.002)] == FREE).all()
    hidden = shown & (height < 0.0)
    ray = np.linalg.norm(CENTRES - ABOVE.matrix[:3, 3], axis=-1) / projected[..., 2]
    deep = (-height * ray)[hidden] / BEHIND_STEP_M
    assert np.abs(code[hidden] - (1.0 + np.floor(deep))).max() <= 1.0
    assert code[hidden].max() > 25
    assert not (code[shown & (height <= FREE_MARGIN_M - 0.002)] == FREE).any()


def test_the_arm_is_no_surface_and_hides_what_is_behind_it():
    """A ball on the way from the camera to the plane; the space between camera and ball is seen."""
    ball = np.array([[0.0, 0.0, 0.6, 0.12]])
    with_arm = seen(slab(PLANE_M), ABOVE, spheres=ball)
    arm_aside = seen(slab(PLANE_M), ABOVE)
    gaps = np.linalg.norm(CENTRES - ball[0, :3], axis=-1) - 0.12
    assert (distances_m(with_arm) - distances_m(arm_aside)).min() > -0.004
    assert (with_arm[np.abs(CENTRES[..., 2] - PLANE_M) > 0.11, 0] == 255).all()
    across = np.linalg.norm(CENTRES[..., :2], axis=-1)
    shadow = (across < 0.08) & (CENTRES[..., 2] < 0.6)
    place = ABOVE.matrix[:3, 3]
    ray = np.linalg.norm(CENTRES - place, axis=-1) - np.linalg.norm(place - ball[0, :3])
    deep = (ray + 0.12 + SLACK_M) / BEHIND_STEP_M
    assert np.abs(with_arm[..., 1] - deep)[shadow & (across < 0.02)].max() < 3.0
    hidden = with_arm[shadow | (gaps < 0.0), 1]
    assert FREE < hidden.min() <= hidden.max() < NO_READING
    assert (with_arm[(across < 0.2) & (CENTRES[..., 2] > 0.76), 1] == FREE).all()
    assert (with_arm[gaps > 0.25, 1] == arm_aside[gaps > 0.25, 1])[CENTRES[gaps > 0.25][:, 2] > 0.4].all()


def brute_codes(picture, camera, grid):
    """Voxel by voxel, by the definition."""
    found = np.empty(grid.counts, dtype=np.uint8)
    depth = picture * 1e-3
    for index, centre in zip(np.ndindex(grid.counts), grid.centres_m().reshape(-1, 3), strict=True):
        column, row, far = projected = camera.project(centre)
        if not camera.shows(projected):
            found[index] = OUT_OF_VIEW
            continue
        u, v = int(np.floor(column + 0.5)), int(np.floor(row + 0.5))
        reach = int(np.floor(0.5 * camera.fx * grid.voxel_m / far + 0.5))
        window = depth[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]
        if depth[v, u] == 0.0:
            found[index] = NO_READING
            continue
        limit = window[window > 0.0].min()
        behind = (far - limit) * np.linalg.norm(camera.rays()[v, u]) / BEHIND_STEP_M
        hidden = 1 + int(np.clip(behind, 0.0, MOST_BEHIND - 1))
        found[index] = FREE if far <= limit - FREE_MARGIN_M else hidden
    return found


@pytest.mark.parametrize("seed", range(2))
def test_codes_are_those_of_the_definition(seed):
    rng = np.random.default_rng(seed)
    pose = looking(rng.normal(size=3) * 0.5 + (0, 0, 0.6), rng.normal(size=3) * 0.1, rng.uniform(-3, 3))
    focal = rng.uniform(20.0, 60.0)
    camera = DepthCamera(focal, focal, 15.0, 11.0, 32, 24, pose_of(pose))
    picture = rng.integers(200, 1500, camera.picture_shape).astype(np.uint16)
    picture[rng.random(picture.shape) < 0.2] = 0
    grid = GridBox((-0.5, -0.4, -0.3), 0.07, (14, 12, 13))
    found = observe(picture, camera, grid)[..., 1]
    expected = brute_codes(picture, camera, grid)
    assert len(np.unique(expected)) > 20
    assert (found == expected).mean() > 0.998, "but for roundings"


def test_between_a_thing_and_what_is_behind_it_is_no_surface():
    """A pole before a wall: the rays between their edges show neither."""
    pole = Box(pose_of(make_pose(np.eye(3), (0.0, 0.0, 0.55))), (0.02, 0.3, 0.02))
    obstacles = Obstacles((*slab(0.2).boxes, pole))
    found = distances_m(seen(obstacles, ABOVE))
    truth = np.abs(distance_m(obstacles, CENTRES))
    within = found < TRUNCATION_M - 0.001
    assert (found - truth)[within].min() > -0.005
    beside = (CENTRES[..., 2] > 0.57) & (truth < 0.09) & (np.abs(CENTRES[..., 1]) < 0.25)
    assert beside.any()
    assert np.abs(found - truth)[beside].max() < 0.012, "a pixel at most"


@pytest.mark.parametrize("family", FAMILIES)
def test_in_scenes_of_the_families_no_obstacle_is_free_and_no_surface_is_made_up(family):
    """Roundings of silhouettes make a surface up to 8 mm off in about two voxels of 100,000."""
    grid = grid_of(PANDA)
    layout = draw_layout(SpatialScenes(floor=1.0), Split.VALIDATION, 4, 0, family)
    cameras = draw_cameras(CameraViews(count=(2, 2)), np.random.default_rng(5), layout)
    found = seen(layout.obstacles, *cameras, grid=grid, spheres=SPHERES)
    signed = distance_m(layout.obstacles, grid.centres_m())
    free = found[..., 1] == FREE
    assert free.mean() > 0.03
    assert signed[free].min() > -0.015
    away = distances_m(found)
    within = away < TRUNCATION_M - 0.001
    under = (np.abs(signed) - away)[within]
    assert within.sum() > 5000
    assert under.max() < 0.008
    assert (under > 0.005).mean() < 1e-4


def test_lookup_at_centres_and_between_and_outside():
    rng = np.random.default_rng(0)
    grid = GridBox((-0.1, 0.2, 0.3), 0.05, (4, 5, 6))
    found = rng.integers(0, 256, (4, 5, 6, 2)).astype(np.uint8)
    known = lookup(found, grid, grid.centres_m())
    np.testing.assert_allclose(known.distance_m, distances_m(found), atol=1e-6)
    np.testing.assert_array_equal(known.codes, found[..., 1])
    np.testing.assert_array_equal(known.unseen, found[..., 1] != FREE)
    corner = np.array(grid.low_m) + 0.05 * np.array((2.0, 3.0, 1.0))
    mean = distances_m(found)[1:3, 2:4, 0:2].mean()
    assert lookup(found, grid, corner).distance_m == pytest.approx(mean, abs=1e-6)
    outside = lookup(found, grid, [[9.0, 0, 0], [-0.101, 0.3, 0.4], [np.nan, 0.3, 0.4], [0.0, 0.3, 1e30]])
    np.testing.assert_allclose(outside.distance_m, TRUNCATION_M)
    assert (outside.codes == OUT_OF_VIEW).all()
    assert outside.unseen.all()
