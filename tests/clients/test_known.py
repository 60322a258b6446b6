"""Scenes of MoveIt and MotionBenchMaker as the API's known bodies."""

import io

import numpy as np
import pytest
import trimesh

from cspace_client import Known, SamplerError

TURNED = {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 1, "w": 1}}
ORIGIN = {"position": [0, 0, 0], "orientation": [0, 0, 0, 1]}
BOX = {"type": 1, "dimensions": [1, 2, 3]}
TRIANGLE = {
    "vertices": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}, {"x": 0, "y": 1, "z": 0}],
    "triangles": [{"vertex_indices": [0, 1, 2]}],
}
SHELF = {
    "id": "shelf",
    "header": {"frame_id": "base"},
    "pose": TURNED,
    "primitives": [BOX, {"type": "cylinder", "dimensions": [0.5, 0.1]}],
    "primitive_poses": [ORIGIN, {"position": [1, 0, 0], "orientation": [0, 0, 0, 0]}],
}


def scene_of(*objects):
    return {"world": {"collision_objects": list(objects)}}


def test_shapes_of_an_object_become_bodies_at_their_places():
    first, second = Known.of_moveit(scene_of(SHELF), base="base").fields["scene"]
    assert (first["name"], first["box"]) == ("shelf", {"size_m": [1.0, 2.0, 3.0]})
    np.testing.assert_allclose(
        first["pose"], [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-12
    )
    assert (second["name"], second["cylinder"]) == ("shelf/1", {"length_m": 0.5, "radius_m": 0.1})
    # A meter along its own x axis, which the object has turned to y.
    np.testing.assert_allclose(np.array(second["pose"])[:3, 3], [1, 3, 3])


def test_a_mesh_becomes_a_binary_stl():
    known = Known.of_moveit(scene_of({"id": "leaf", "meshes": [TRIANGLE], "mesh_poses": [None]}))
    assert known.fields["scene"][0]["mesh"] == {"file": "leaf-0.stl"}
    read = trimesh.load_mesh(io.BytesIO(known.meshes["leaf-0.stl"]), file_type="stl")
    np.testing.assert_array_equal(read.triangles, [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])


def test_what_the_arm_holds_and_what_may_touch_keep_their_names():
    held = {"link_name": "hand", "touch_links": ["finger"], "object": SHELF | {"header": {}}}
    matrix = {
        "entry_names": ["hand", "shelf", "arm"],
        "entry_values": [{"enabled": row} for row in ([0, 1, 1], [1, 0, 0], [1, 0, 0])],
    }
    scene = {"robot_state": {"attached_collision_objects": [held]}, "allowed_collision_matrix": matrix}
    fields = Known.of_moveit(scene).fields
    assert [(one["name"], one["link"], one["touch_links"]) for one in fields["attached"]] == [
        ("shelf", "hand", ["finger"]),
        ("shelf/1", "hand", ["finger"]),
    ]
    assert fields["allowed"] == [("hand", "shelf"), ("hand", "shelf/1")]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"header": {"frame_id": "map"}}, "another frame"),
        ({"primitives": [{"type": 4, "dimensions": [1, 1]}]}, "cannot be sent"),
        ({"primitives": []}, "no shape"),
    ],
)
def test_what_the_api_does_not_know_is_named(wrong, words):
    with pytest.raises(SamplerError, match=words):
        Known.of_moveit(scene_of(SHELF | wrong), base="base")
