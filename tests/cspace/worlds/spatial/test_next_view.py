"""Where to look next: at the most uncertain part of a path, past known obstacles."""

import tracemalloc

import numpy as np
import pytest

from cspace.errors import InputError
from cspace.worlds import best_view, examples, unseen_space
from cspace.worlds.spatial.camera import DepthCamera, looking, to_mm
from cspace.worlds.spatial.furniture import block
from cspace.worlds.spatial.next_view import hemisphere, seen_shares
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.rendering import render_depth
from cspace.worlds.spatial.sensor import FREE
from cspace.worlds.spatial.visibility import observe

WORLD = examples()["panda"]
# A board across, 60 cm before the base, seen from the front.
BOARD = Obstacles.of((block((0.59, 0.61), (-0.4, 0.4), (0.0, 0.8)),))
BEHIND, BEFORE = np.array([[0.75, 0.0, 0.4]]), np.array([[0.45, 0.0, 0.4]])


def camera(x, y, z=0.8):
    return DepthCamera.of_field(128, 128, 70.0, looking((x, y, z), (0.6, 0.0, 0.4)))


FRONT, BACK = camera(-0.6, 0.3), camera(1.8, 0.2)


@pytest.fixture(scope="module")
def picture():
    seen = to_mm(render_depth(BOARD, FRONT).depth_m)
    return observe(seen, FRONT, WORLD.sensor.grid)


@pytest.fixture(scope="module")
def doubt():
    """Half as likely as not, behind the board."""
    places = WORLD.sensor.grid.centres_m() - BEHIND
    return np.where(np.abs(places).max(axis=-1) < 0.05, np.float32(0.25), np.float32(0.0))


def test_what_lies_behind_a_surface_that_was_seen_is_seen_from_the_other_side(picture):
    assert seen_shares(WORLD, picture, FRONT, BEHIND)[0] == 0.0
    assert seen_shares(WORLD, picture, BACK, BEHIND)[0] > 0.1
    assert seen_shares(WORLD, picture, FRONT, BEFORE)[0] > 0.8
    aside = DepthCamera.of_field(128, 128, 70.0, looking((1.8, 0.2, 0.8), (3.0, 0.0, 0.4)))
    assert seen_shares(WORLD, picture, aside, BEHIND)[0] == 0.0


def test_the_camera_that_sees_the_doubtful_space_is_named(picture, doubt):
    given = [FRONT.to_dict(), BACK.to_dict()]
    found = best_view(WORLD, picture, doubt, given)
    assert found.camera == given[1]
    assert 0.1 < found.sees < 1.0
    assert best_view(WORLD, picture, doubt, given[:1]) is None
    assert best_view(WORLD, picture, np.zeros_like(doubt), given) is None
    assert 0.0 < best_view(WORLD, picture, doubt).sees <= 1.0


def test_cameras_from_elsewhere_go_first(picture, doubt):
    beside, across = camera(1.9, 0.1), camera(0.6, 1.5, 1.2)
    given = [BACK.to_dict(), beside.to_dict()]
    best = best_view(WORLD, picture, doubt, given)
    other = best_view(WORLD, picture, doubt, [across.to_dict()])
    assert 0.0 < other.sees < best.sees
    given.append(across.to_dict())
    assert best_view(WORLD, picture, doubt, given) == best
    camera_values = {"pose": camera(1.8, 0.0).to_dict()["pose"]}
    assert best_view(WORLD, picture, doubt, given, seen_by=[camera_values]) == other
    # Where nobody looks from elsewhere, the best of the others is better than none.
    assert best_view(WORLD, picture, doubt, given[:2], seen_by=[camera_values]) == best


def test_the_hemisphere_has_another_side(picture, doubt):
    for side in (1.0, -1.0):
        camera_values = {"pose": camera(-0.2, side).to_dict()["pose"]}
        found = best_view(WORLD, picture, doubt, seen_by=[camera_values])
        assert side * np.array(found.camera["pose"])[1, 3] < 0.0


def test_doubt_lies_in_unseen_space_about_the_arm_where_the_field_is_unsure(picture):
    world, row = WORLD, np.full((1, 7), 0.5)
    occupancy = np.full(picture.shape[:-1], 0.5, dtype=np.float32)
    occupancy[:, :, :20] = 1.0
    far = np.full((1, 7), -2.0)
    doubt = unseen_space(world, picture, occupancy, far).doubt_along(row)
    assert set(np.unique(doubt)) == {0.0, 0.25}
    assert not doubt[picture[..., 1] == FREE].any()
    assert not doubt[:, :, :20].any()
    centres = world.sensor.grid.centres_m()[doubt > 0.0]
    spheres = world.body.sphere_centres_m(row)[0]
    away = np.linalg.norm(centres[:, None] - spheres, axis=-1) - world.body.spheres_m()[:, 3]
    assert away.min(axis=1).max() <= 0.03 + 1e-6
    assert not unseen_space(world, picture, occupancy, row).doubt_along(row).any()


def test_the_hemisphere_is_about_its_middle_and_not_in_the_arm():
    cameras = hemisphere(WORLD, np.array([0.4, 0.1, 0.3]))
    assert 20 < len(cameras) <= 30
    for one in cameras:
        column, row, depth = one.project(np.array([0.4, 0.1, 0.3]))
        assert (column, row, depth) == pytest.approx((63.5, 63.5, 1.25), abs=1e-6)
        assert np.hypot(*one.matrix[:2, 3]) >= 0.35


@pytest.mark.parametrize("view", [None, FRONT.to_dict() | {"fx": -1.0}])
def test_what_is_no_camera_is_refused(picture, doubt, view):
    with pytest.raises(InputError, match="no camera"):
        best_view(WORLD, picture, doubt, [view])


@pytest.mark.parametrize("camera_values", [{}, {"pose": np.full((4, 4), 2.0).tolist()}])
def test_a_camera_without_a_pose_has_seen_nothing(picture, doubt, camera_values):
    with pytest.raises(InputError, match="pose"):
        best_view(WORLD, picture, doubt, [BACK.to_dict()], seen_by=[camera_values])


def test_a_camera_that_is_far_away_costs_no_more_than_one_that_is_near(picture):
    far = DepthCamera.of_field(128, 128, 70.0, looking((90.0, 0.2, 0.8), (0.6, 0.0, 0.4)))
    tracemalloc.start()
    assert seen_shares(WORLD, picture, far, np.repeat(BEHIND, 512, axis=0)).min() > 0.1
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 60e6


def test_whoever_calls_can_stop_between_two_cameras(picture, doubt):
    called = []

    def stop():
        called.append(None)
        if len(called) == 2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        best_view(WORLD, picture, doubt, check_cancelled=stop)
    assert len(called) == 2
