"""Scene files and options of the spatial world."""

import json

import numpy as np
import pytest
import yaml

from cspace.errors import ConfigError, ScenarioError
from cspace.worlds import examples, named_world
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.obstacles import Box, Cylinder
from services.scene_files import given_scenes, read_scene_file

PANDA = examples()["panda"]
READY = ready_rad(PANDA.body).round(3).tolist()
SCENE = {
    "world": "spatial",
    "robot": "panda",
    "obstacles": [
        {
            "shape": "box",
            "at_m": [0.5, 0.0, 0.2],
            "size_m": [0.4, 0.6, 0.1],
            "yaw_pitch_roll_deg": [90, 0, 0],
        },
        {"shape": "cylinder", "at_m": [0.4, 0.3, 0.3], "radius_m": 0.05, "height_m": 0.2},
    ],
    "cameras": [{"at_m": [1.2, 0.5, 0.9], "look_at_m": [0.4, 0.0, 0.2], "field_deg": 60}],
    "start": READY,
    "goal": [0.3, *READY[1:]],
}


def read(folder, **changes):
    path = folder / "scene.yaml"
    values = {name: value for name, value in (SCENE | changes).items() if value is not None}
    path.write_text(yaml.safe_dump(values))
    return read_scene_file(path)


def test_a_file_says_what_stands_where_and_who_looks(tmp_path):
    found = read(tmp_path)
    assert found.world == PANDA
    (box,), (cylinder,) = found.scene.obstacles.boxes, found.scene.obstacles.cylinders
    assert isinstance(box, Box)
    assert isinstance(cylinder, Cylinder)
    np.testing.assert_allclose(box.half_m, (0.2, 0.3, 0.05))
    np.testing.assert_allclose(np.array(box.pose)[:3, 0], (0.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(np.array(cylinder.pose)[:3, 3], (0.4, 0.3, 0.3))
    assert (cylinder.radius_m, cylinder.half_length_m) == (0.05, 0.1)
    (camera,) = found.scene.cameras
    np.testing.assert_allclose(np.array(camera.pose)[:3, 3], (1.2, 0.5, 0.9))
    assert found.scene.state == tuple(READY)
    problem = found.problem()
    np.testing.assert_allclose(problem.goal, SCENE["goal"])


@pytest.mark.parametrize(
    "changes",
    [
        {"robot": "kuka"},
        {"robot": {"name": "x"}},
        {"state": [0.0]},
        {"goal": [9.0, *READY[1:]]},
        {"obstacles": [{"shape": "ball", "at_m": [0, 0, 0]}]},
        {"obstacles": [{"shape": "box", "at_m": [0, 0, 0], "size_m": [0.1, 0.1]}]},
        {"cameras": []},
        {"colour": "red"},
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, changes):
    with pytest.raises(ScenarioError):
        read(tmp_path, **changes)


def test_scenes_of_files_are_planned_in_and_not_learned_from(tmp_path):
    one = read(tmp_path)
    with pytest.raises(ScenarioError):
        given_scenes(one.world, [one])


def test_an_arm_is_read_from_its_file(tmp_path):
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(PANDA.body.to_dict()))
    assert named_world(str(path)) == PANDA
    with pytest.raises(ScenarioError):
        named_world("kuka")
    for text in ("{", "[" * 100_000, '{"a": NaN}'):
        path.write_text(text)
        with pytest.raises(ConfigError):
            named_world(str(path))
    path.write_text(" " * (2**20 + 1))
    with pytest.raises(ConfigError):
        named_world(str(path))
