import json

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.files import parse_json, read_object
from cspace.worlds.spatial.obstacles import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import HERE, make_pose, pose_of, turned

TURNED = pose_of(make_pose(turned(0.3, -0.8, 1.1), (0.5, -0.2, 0.7)))


def scaled(factor):
    return pose_of(np.diag((factor, factor, factor, 1.0)))


WRONG_POSES = {
    "no rotation but a stretch": scaled(1.01),
    "a mirror": pose_of(np.diag((1.0, 1.0, -1.0, 1.0))),
    "another last row": (*HERE[:3], (0.0, 0.0, 0.0, 2.0)),
    "not a number": ((float("nan"), 0.0, 0.0, 0.0), *HERE[1:]),
    "farther than anything": ((1.0, 0.0, 0.0, 101.0), *HERE[1:]),
    "numbers whose product overflows": ((1e200, 0.0, 0.0, 0.0), *HERE[1:]),
}


@pytest.mark.parametrize("pose", WRONG_POSES.values(), ids=WRONG_POSES.keys())
def test_a_shape_refuses_what_is_no_pose(pose):
    with pytest.raises(ScenarioError):
        Box(pose, (1, 1, 1))
    with pytest.raises(ScenarioError):
        Cylinder(pose, 1, 1)


def test_obstacles_come_back_from_json_as_they_were():
    obstacles = Obstacles.of((Cylinder(TURNED, 1, 0.2), Box(TURNED, (1, 2, 0.3)), Box(HERE, (0.1, 0.1, 0.1))))
    read = read_object(Obstacles, parse_json(json.dumps(obstacles.to_dict()).encode()), "it", ScenarioError)
    assert read == obstacles
    assert hash(read) == hash(obstacles)
    assert (len(read.boxes), len(read.cylinders)) == (2, 1)


def test_kernels_get_centre_axes_sizes_and_the_sphere_around():
    arrays = Obstacles((Box(TURNED, (1.0, 2.0, 2.0)),), (Cylinder(TURNED, 3.0, 4.0),)).arrays
    turn = np.array(TURNED)[:3, :3].ravel()
    np.testing.assert_array_equal(arrays.boxes[0], [0.5, -0.2, 0.7, *turn, 1.0, 2.0, 2.0, 3.0])
    np.testing.assert_array_equal(arrays.cylinders[0], [0.5, -0.2, 0.7, *turn, 3.0, 4.0, 5.0])
