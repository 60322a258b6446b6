import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.simulator import Split
from cspace.strict_json import parse_json, read_object
from cspace.worlds.spatial.distances import distance_m
from cspace.worlds.spatial.furniture import (
    FAMILIES,
    Bins,
    Cages,
    Layout,
    Shelves,
    SpatialScenes,
    Tables,
)
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of
from cspace.worlds.spatial.scenes import base_clearance_m, draw_layout, scenes_of
from cspace.worlds.spatial.world import shipped, usual

SCENES = SpatialScenes()


@pytest.fixture(scope="module")
def drawn():
    return {
        name: [draw_layout(SCENES, Split.TRAIN, 3, index, name) for index in range(12)] for name in FAMILIES
    }


def test_an_arm_high_above_its_first_link_has_its_scenes_about_the_shoulder(drawn):
    ur5 = shipped("ur5")
    first = replace(ur5.joints[0], origin=replace(ur5.joints[0].origin, xyz_m=(0.3, 0.0, 1.2)))
    scenes = scenes_of(usual(replace(ur5, joints=(first, *ur5.joints[1:]))))
    assert (usual(ur5).scenes, usual(shipped("panda")).scenes) == (SCENES, SCENES)
    assert scenes.base_m == pytest.approx((0.3, 0.0, 0.72))
    plain = drawn["table"][0]
    raised = draw_layout(scenes, Split.TRAIN, 3, 0, "table")
    for name in ("boxes", "cylinders"):
        places, found = (
            np.array([one.pose for one in getattr(layout.obstacles, name)]).reshape(-1, 4, 4)[:, :3, 3]
            for layout in (plain, raised)
        )
        np.testing.assert_allclose(found, places + scenes.base_m)
    np.testing.assert_allclose(raised.focus, np.add(plain.focus, scenes.base_m))
    region = np.array(raised.regions[0].box.pose)[:3, 3]
    np.testing.assert_allclose(region, np.array(plain.regions[0].box.pose)[:3, 3] + scenes.base_m)
    written = parse_json(json.dumps(scenes.to_dict()).encode())
    assert read_object(SpatialScenes, written, "the scenes", ScenarioError) == scenes


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


def test_the_shares_of_the_families_are_as_set():
    only = replace(SCENES, shares=(0, 0, 0, 1, 0, 0, 0))
    assert {draw_layout(only, Split.TRAIN, 0, index).family for index in range(5)} == {"bin"}
    found = [draw_layout(SCENES, Split.TRAIN, 0, index).family for index in range(100)]
    assert set(found) == set(FAMILIES)
    assert 12 <= found.count("shelf") <= 42


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


def test_the_column_of_the_base_is_as_high_as_the_shoulder_turns():
    for height in (0.0, 0.25, 0.5):
        rod = Cylinder(pose_of(make_pose(np.eye(3), (0.1, 0.0, height))), 0.01, 0.02)
        assert base_clearance_m(Obstacles((), (rod,))) < 0.0
    assert (
        base_clearance_m(Obstacles((Box(pose_of(make_pose(np.eye(3), (0, 0, -0.1))), (1, 1, 0.04)),))) > 0.0
    )


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


def test_scenes_are_all_round_the_arm_and_of_many_sizes(drawn):
    focus = np.array([layout.focus for layouts in drawn.values() for layout in layouts])
    bearings = np.degrees(np.arctan2(focus[:, 1], focus[:, 0]))
    assert bearings.min() < -85.0
    assert bearings.max() > 85.0
    assert np.ptp(focus[:, 2]) > 0.5
    assert len({len(layout.obstacles) for layouts in drawn.values() for layout in layouts}) > 15


def test_a_scene_comes_back_from_json_as_it_was(drawn):
    for layouts in drawn.values():
        values = parse_json(json.dumps(layouts[0].to_dict()).encode())
        assert read_object(Layout, values, "the scene", ScenarioError) == layouts[0]
    values = parse_json(json.dumps(SCENES.to_dict()).encode())
    assert read_object(SpatialScenes, values, "the scenes", ScenarioError) == SCENES


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


def test_lids_are_hinged_at_the_opening_and_leave_it_free():
    for seed in range(8):
        lidded, bare = (
            Bins(lid=lid, lid_rad=(1.6, 2.4), lower_wall=0.0, objects=(0, 0)).draw(
                np.random.default_rng(seed)
            )
            for lid in (1.0, 0.0)
        )
        assert len(lidded.shapes) == len(bare.shapes) + 1 == 6
        lid, (region,) = Obstacles.of(lidded.shapes[-1:]), lidded.regions
        centre = np.array(region.box.pose)[:3, 3]
        line = centre - np.linspace(0.0, 1.0, 100)[:, None] * region.approach
        assert (distance_m(lid, line) > 0.0).all()
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        pose, half = np.array(lidded.shapes[-1].pose), lidded.shapes[-1].half_m
        opening = centre - np.array(region.approach) * region.box.half_m[2]
        assert (pose[:3, 3] - opening) @ region.approach < 0.0, "outside, above the opening"
        ends = (corners * half) @ pose[:3, :3].T + pose[:3, 3]
        assert distance_m(Obstacles.of(lidded.shapes[:-1]), ends).min() < 0.05


def test_cages_have_a_gap_in_front_for_a_hand():
    cages = Cages(objects=(0, 0), side_m=(0.6, 0.6), front_m=(0.2, 0.3))
    for seed in range(10):
        piece = cages.draw(np.random.default_rng(seed))
        (region,) = piece.regions
        bottom = np.array(region.box.pose)[2, 3]
        y, z = (
            one.ravel()
            for one in np.meshgrid(np.linspace(-0.28, 0.28, 57), bottom + np.linspace(-0.25, 0.25, 51))
        )
        plane = np.column_stack((np.zeros(len(y)), y, z))
        assert distance_m(Obstacles.of(piece.shapes), plane).max() > 0.06


def test_goals_at_a_table_are_above_its_board_and_under_it_below_too():
    for seed in range(10):
        under = Tables().draw(np.random.default_rng(seed), under=True)
        above = Tables().draw(np.random.default_rng(seed), under=False)
        for piece, expected in ((under, [1, 1, -1]), (above, [1, 1])):
            drawn = [region.draw(np.random.default_rng(0), 100)[:, 2] for region in piece.regions]
            sides = np.sign(np.array(drawn) - piece.shapes[0].pose[2][3])
            np.testing.assert_array_equal(sides, np.repeat(np.array(expected)[:, None], 100, axis=1))


@pytest.mark.parametrize(
    "make",
    [
        lambda: SpatialScenes(shares=(1.0,)),
        lambda: SpatialScenes(shares=(0.0,) * 7),
        lambda: SpatialScenes(bearing_deg=200.0),
        lambda: SpatialScenes(distance_m=(0.7, 0.2)),
        lambda: SpatialScenes(floor=1.5),
        lambda: SpatialScenes(strays=(-1, 3)),
        lambda: SpatialScenes(reach_m=0.0),
        lambda: Shelves(width_m=(1.0, 0.5)),
        lambda: Shelves(back=-0.1),
        lambda: Shelves(boards=(1, 4)),
        lambda: Tables(objects=(3, 1)),
        lambda: Bins(side_m=(float("nan"), 1.0)),
        lambda: Cages(spacing_m=(0.0, 0.2)),
        lambda: draw_layout(SCENES, Split.TRAIN, 0, 0, "garage"),
        lambda: draw_layout(SpatialScenes(reach_m=0.05), Split.TRAIN, 0, 0, "shelf"),
    ],
)
def test_settings_that_cannot_be_are_refused(make):
    with pytest.raises(ScenarioError):
        make()
