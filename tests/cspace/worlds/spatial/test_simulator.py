"""The spatial world behind the seam: a value, its scenes, their pictures and checks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from cspace.errors import ScenarioError
from cspace.files import parse_json
from cspace.simulator import Simulator, Split
from cspace.world import World
from cspace.worlds import read_world
from cspace.worlds.spatial.simulator import open_simulator
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual

WORLD: SpatialWorld = usual(shipped("panda"))
SIMULATOR: Simulator = open_simulator(WORLD)


@pytest.fixture(scope="module")
def scenes():
    return SIMULATOR.scenes(Split.VALIDATION, 0, 3)


def test_the_world_is_read_from_what_it_tells():
    world: World = WORLD
    values = world.to_dict()
    assert values["kind"] == "spatial"
    again = read_world(parse_json(json.dumps(values).encode()))
    assert again == world
    assert hash(again) == hash(world)
    unknown = replace(WORLD, scenes=None)
    assert read_world(parse_json(json.dumps(unknown.to_dict()).encode())) == unknown
    with pytest.raises(ScenarioError, match="colour is unknown"):
        read_world(values | {"colour": 1})


def test_a_scene_is_that_of_its_split_seed_and_index(scenes):
    again = SIMULATOR.scenes(Split.VALIDATION, 0, 2)
    assert list(again) == list(scenes[:2])
    assert scenes[0] != scenes[1]
    assert SIMULATOR.scenes(Split.TRAIN, 0, 1)[0] != scenes[0]
    assert all(scene.state is not None for scene in scenes)
    assert all(SIMULATOR.checker(scene).valid(scene.state) for scene in scenes)


def test_a_scene_s_file_is_read_as_its_picture(scenes):
    for scene in scenes:
        picture = SIMULATOR.render(scene)
        assert picture.shape == WORLD.sensor.picture_shape
        assert picture.dtype == np.uint8
        assert np.array_equal(WORLD.read_picture(SIMULATOR.picture_file(scene)), picture)
        assert 0.02 < (picture[..., 1] == 0).mean() < 0.98
        assert (picture[..., 0] < 255).mean() > 0.01


@pytest.mark.slow
def test_a_problem_is_seen_from_where_the_arm_starts():
    problem = SIMULATOR.problem("bin", Split.VALIDATION, 1, 2)
    assert problem.family == "bin"
    assert problem.scenario.state == tuple(problem.start)
    checker = SIMULATOR.checker(problem.scenario)
    assert checker.valid_batch(np.stack([problem.start, problem.goal])).all()
    assert SIMULATOR.obstruction(problem) is None
    path = SIMULATOR.path_search(problem.scenario)(problem.start, problem.goal)
    assert checker.edge_batch(path[:-1], path[1:], 0.01).all()
    again = SIMULATOR.problem("bin", Split.VALIDATION, 1, 2)
    assert np.array_equal(again.goal, problem.goal)
    assert again.scenario == problem.scenario
    buried = replace(problem, goal=np.zeros(7))
    assert "the goal is" in SIMULATOR.obstruction(buried)


def test_scene_and_robot_are_drawn(scenes):
    axes = Figure().subplots()
    SIMULATOR.draw_scene(axes, scenes[0], "grey")
    obstacles = len(axes.patches)
    SIMULATOR.draw_robot(axes, np.asarray(scenes[0].state), "blue", 3)
    assert obstacles == len(scenes[0].obstacles)
    assert len(axes.patches) == obstacles + WORLD.body.sphere_count
