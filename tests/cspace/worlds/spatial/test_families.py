import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.files import parse_json, read_object
from cspace.simulator import Split
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.furniture import (
    FAMILIES,
    Bins,
    Shelves,
    SpatialScenes,
)
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.scenes import base_clearance_m, draw_layout

SCENES = SpatialScenes()


@pytest.fixture(scope="module")
def drawn():
    return {
        name: [draw_layout(SCENES, Split.TRAIN, 3, index, name) for index in range(12)] for name in FAMILIES
    }


def test_a_scene_is_told_by_split_seed_and_index():
    def some(split, seed):
        return [draw_layout(SCENES, split, seed, index) for index in range(8)]

    first = some(Split.TRAIN, 0)
    assert some(Split.TRAIN, 0) == first
    assert len(set(first)) == 8
    for other in (some(Split.TEST, 0), some(Split.TRAIN, 1)):
        assert not set(other) & set(first)
    backwards = [draw_layout(SCENES, Split.TRAIN, 0, index) for index in reversed(range(8))]
    assert backwards[::-1] == first


def test_an_arm_may_stand_on_something_that_ends_at_its_base():
    mounted = replace(SCENES, mounted=1.0)
    values = parse_json(json.dumps(mounted.to_dict()).encode())
    assert read_object(SpatialScenes, values, "scenes", ScenarioError) == mounted
    assert "mounted" not in SCENES.to_dict()
    for index in range(8):
        layout, plain = (draw_layout(one, Split.TRAIN, 0, index) for one in (mounted, SCENES))
        # The rest of the scene is what it is without.
        more = layout.obstacles.boxes[len(plain.obstacles.boxes) :]
        tops = [
            (box.pose[2][3] + box.half_m[2], box)
            for box in more
            if abs(box.pose[2][3] + box.half_m[2]) < 1e-9
        ]
        assert len(tops) == 1
        table = tops[0][1]
        assert abs(table.pose[0][3]) < table.half_m[0]
        assert abs(table.pose[1][3]) < table.half_m[1]
        standing = [box for box in more if box != table]
        assert all(base_clearance_m(Obstacles((box,), ())) > 0.0 for box in standing)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_region_has_a_free_place_within_reach_and_nothing_stands_where_the_base_is(drawn, family):
    rng = np.random.default_rng(0)
    for layout in drawn[family]:
        assert layout.family == family
        assert base_clearance_m(layout.obstacles) > 0.0
        assert layout.regions
        for region in layout.regions:
            places = region.draw(rng, 5000)
            near = np.linalg.norm(places - (0, 0, SCENES.shoulder_m), axis=1) <= SCENES.reach_m
            assert (near & (distance_m(layout.obstacles, places) >= SCENES.room_m)).any()


def test_shelves_are_open_to_the_front_whether_or_not_they_have_a_back():
    for back in (0.0, 1.0):
        shelves = Shelves(
            back=back, divider=0.0, objects=(0, 0), depth_m=(0.3, 0.3), thickness_m=(0.02, 0.02)
        )
        piece = shelves.draw(np.random.default_rng(1))
        obstacles = Obstacles.of(piece.shapes)
        for region in piece.regions:
            middle = np.array(region.box.pose)[2, 3]
            line = np.column_stack((np.linspace(-0.5, 0.28, 200), np.zeros(200), np.full(200, middle)))
            assert (distance_m(obstacles, line) > 0.0).all()
            assert (distance_m(obstacles, (0.3, 0.0, middle)) < 0.0) == (back == 1.0)


def test_bins_let_hands_in_where_they_are_open_and_nowhere_else():
    bins, opened = Bins(lid=0.0, lower_wall=0.0, objects=(0, 0)), set()
    for seed in range(12):
        piece = bins.draw(np.random.default_rng(seed))
        obstacles, (region,) = Obstacles.of(piece.shapes), piece.regions
        centre = np.array(region.box.pose)[:3, 3]
        for path in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            line = centre - np.linspace(0.0, 1.0, 500)[:, None] * path
            is_open = np.allclose(path, region.approach)
            assert (distance_m(obstacles, line) > 0.0).all() == is_open
        opened.add(region.approach)
    assert {tuple(np.rint(path)) for path in opened} == {(0, 0, -1), (1, 0, 0), (0, 1, 0), (0, -1, 0)}
