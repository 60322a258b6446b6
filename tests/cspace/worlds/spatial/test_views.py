import numpy as np

from cspace.simulator import Split
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.furniture import SpatialScenes
from cspace.worlds.spatial.scenes import draw_cameras, draw_layout
from cspace.worlds.spatial.sensor import CameraViews

VIEWS = CameraViews()
LAYOUTS = [draw_layout(SpatialScenes(), Split.TRAIN, 11, index) for index in range(30)]


def test_cameras_are_as_far_and_as_high_and_as_wide_as_set_on_both_sides():
    sides, counts = [], set()
    for index, layout in enumerate(LAYOUTS):
        cameras = draw_cameras(VIEWS, np.random.default_rng(index), layout)
        counts.add(len(cameras))
        assert cameras == draw_cameras(VIEWS, np.random.default_rng(index), layout)
        for camera in cameras:
            place, focus = camera.matrix[:3, 3], np.array(layout.focus)
            gap = place - focus
            away = np.linalg.norm(gap)
            assert 0.9 <= away <= 1.6
            assert 10.0 <= np.degrees(np.arcsin(gap[2] / away)) <= 50.0
            turn = np.arctan2(gap[1], gap[0]) - np.arctan2(-focus[1], -focus[0])
            sides.append(np.degrees((turn + np.pi) % (2 * np.pi) - np.pi))
            assert 51.9 <= np.degrees(2 * np.arctan(camera.width / 2 / camera.fx)) <= 85.1
            assert distance_m(layout.obstacles, place) >= VIEWS.clear_m
            assert camera.shows(camera.project(focus))
    sides = np.array(sides)
    assert counts == {1, 2, 3}
    assert (np.abs(sides) >= 14.9).all()
    assert (np.abs(sides) <= 75.1).all()
    assert 0.3 < (sides > 0).mean() < 0.7
