"""Where to look next: at the most uncertain part of a path, past known obstacles."""

import tracemalloc

import numpy as np
import pytest

from cspace.errors import InputError
from cspace.worlds import best_view, examples
from cspace.worlds.spatial.camera import DepthCamera, looking, to_mm
from cspace.worlds.spatial.furniture import block
from cspace.worlds.spatial.next_view import hemisphere, seen_shares
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.rendering import render_depth
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
def reaching():
    """Configurations whose hands reach past the board."""
    rows = WORLD.space.sample_uniform(np.random.default_rng(0), 4000)
    tips = WORLD.body.joint_positions_m(rows)[:, -1]
    found = rows[(tips[:, 0] > 0.66) & (np.abs(tips[:, 1]) < 0.3) & (np.abs(tips[:, 2] - 0.4) < 0.3)]
    assert len(found) > 3
    return found[:8]


def test_what_lies_behind_a_surface_that_was_seen_is_seen_from_the_other_side(picture):
    assert seen_shares(WORLD, picture, FRONT, BEHIND)[0] == 0.0
    assert seen_shares(WORLD, picture, BACK, BEHIND)[0] > 0.1
    assert seen_shares(WORLD, picture, FRONT, BEFORE)[0] > 0.8
    aside = DepthCamera.of_field(128, 128, 70.0, looking((1.8, 0.2, 0.8), (3.0, 0.0, 0.4)))
    assert seen_shares(WORLD, picture, aside, BEHIND)[0] == 0.0


def test_the_camera_that_sees_the_uncertain_space_is_named(picture, reaching):
    costs = np.ones(len(reaching))
    given = [FRONT.to_dict(), BACK.to_dict()]
    found = best_view(WORLD, picture, reaching, costs, given)
    assert found.camera == given[1]
    assert 0.1 < found.sees < 1.0
    again = best_view(WORLD, picture, reaching, costs, given[:1])
    assert again is None or again.sees < 0.3 * found.sees
    around = best_view(WORLD, picture, reaching, costs)
    assert 0.0 < around.sees <= 1.0


def test_no_camera_sees_more_of_states_that_are_seen_whole(picture, reaching):
    assert best_view(WORLD, picture, reaching, np.zeros(len(reaching))) is None
    one = best_view(WORLD, picture, reaching, np.ones(len(reaching)), [BACK.to_dict()])
    more = np.concatenate([np.ones(len(reaching)), np.zeros(5)])
    rows = np.concatenate([reaching, WORLD.space.sample_uniform(np.random.default_rng(1), 5)])
    assert best_view(WORLD, picture, rows, more, [BACK.to_dict()]) == one


def test_cameras_from_elsewhere_go_first(picture, reaching):
    costs, beside = np.ones(len(reaching)), camera(1.9, 0.1)
    given, across = [BACK.to_dict(), beside.to_dict()], camera(0.6, 1.5, 1.2)
    best = best_view(WORLD, picture, reaching, costs, given)
    other = best_view(WORLD, picture, reaching, costs, [across.to_dict()])
    assert 0.0 < other.sees < best.sees
    given.append(across.to_dict())
    assert best_view(WORLD, picture, reaching, costs, given) == best
    camera_values = {"pose": camera(1.8, 0.0).to_dict()["pose"]}
    assert best_view(WORLD, picture, reaching, costs, given, seen_by=[camera_values]) == other
    # Where nobody looks from elsewhere, the best of the others is better than none.
    assert best_view(WORLD, picture, reaching, costs, given[:2], seen_by=[camera_values]) == best


def test_the_hemisphere_has_another_side(picture, reaching):
    costs = np.ones(len(reaching))
    for side in (1.0, -1.0):
        camera_values = {"pose": camera(-0.2, side).to_dict()["pose"]}
        found = best_view(WORLD, picture, reaching, costs, seen_by=[camera_values])
        assert side * np.array(found.camera["pose"])[1, 3] < 0.0


def test_the_hemisphere_is_about_its_middle_and_not_in_the_arm():
    cameras = hemisphere(WORLD, np.array([0.4, 0.1, 0.3]))
    assert 20 < len(cameras) <= 30
    for one in cameras:
        column, row, depth = one.project(np.array([0.4, 0.1, 0.3]))
        assert (column, row, depth) == pytest.approx((63.5, 63.5, 1.25), abs=1e-6)
        assert np.hypot(*one.matrix[:2, 3]) >= 0.35


@pytest.mark.parametrize("view", [None, FRONT.to_dict() | {"fx": -1.0}])
def test_what_is_no_camera_is_refused(picture, reaching, view):
    with pytest.raises(InputError, match="no camera"):
        best_view(WORLD, picture, reaching, np.ones(len(reaching)), [view])


@pytest.mark.parametrize("camera_values", [{}, {"pose": np.full((4, 4), 2.0).tolist()}])
def test_a_camera_without_a_pose_has_seen_nothing(picture, reaching, camera_values):
    with pytest.raises(InputError, match="pose"):
        best_view(WORLD, picture, reaching, np.ones(len(reaching)), [BACK.to_dict()], seen_by=[camera_values])


def test_the_plane_is_seen_whole():
    world = examples()["two-link"]
    image = np.zeros(world.sensor.picture_shape, dtype=np.uint8)
    assert best_view(world, image, np.zeros((3, 2)), np.ones(3)) is None


def test_a_camera_that_is_far_away_costs_no_more_than_one_that_is_near(picture):
    far = DepthCamera.of_field(128, 128, 70.0, looking((90.0, 0.2, 0.8), (0.6, 0.0, 0.4)))
    tracemalloc.start()
    assert seen_shares(WORLD, picture, far, np.repeat(BEHIND, 512, axis=0)).min() > 0.1
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 60e6


def test_whoever_calls_can_stop_between_two_cameras(picture, reaching):
    called = []

    def stop():
        called.append(None)
        if len(called) == 2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        best_view(WORLD, picture, reaching, np.ones(len(reaching)), check_cancelled=stop)
    assert len(called) == 2
