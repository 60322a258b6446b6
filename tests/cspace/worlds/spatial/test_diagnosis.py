"""The diagnosis: each mistake in a view is named, and nothing is found where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.worlds import examples
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.camera import OPTICAL_IN_BODY, DepthCamera, looking, to_mm
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of, quaternion_of, quaternion_pose, turn, turn_deg
from cspace.worlds.spatial.rendering import render_depth, structured_light
from cspace.worlds.spatial.view import DepthView, write_view

WORLD = examples()["panda"]
STATE = tuple(ready_rad(WORLD.body).tolist())
CAMERA = DepthCamera.of_field(128, 128, 65.0, looking((1.2, 0.9, 0.9), (0.2, 0.0, 0.35)))
OTHER = DepthCamera.of_field(128, 128, 65.0, looking((1.2, -0.9, 0.9), (0.2, 0.0, 0.35)))


def box(middle, half):
    return Box(pose_of(make_pose(np.eye(3), middle)), half)


TABLE, FLOOR = box((0.7, 0.0, 0.2), (0.3, 0.5, 0.02)), box((0.0, 0.0, -0.3), (1.5, 1.5, 0.02))
OBSTACLES = Obstacles.of((TABLE, FLOOR, box((0.6, 0.25, 0.32), (0.06, 0.06, 0.1))))


def taken(camera, state=STATE, obstacles=OBSTACLES):
    spheres = None if state is None else WORLD.body.spheres_at(state)
    exact = render_depth(obstacles, camera, spheres)
    return to_mm(structured_light(np.random.default_rng(1), exact, camera))


PICTURE, SECOND = taken(CAMERA), taken(OTHER)
VIEW = DepthView((PICTURE,), (CAMERA,), STATE)


def view_of(pose):
    return replace(VIEW, cameras=(replace(CAMERA, pose=pose_of(pose)),))


def codes(view):
    return {one.code for one in WORLD.diagnosed(view).findings}


def test_a_right_view_has_notes_alone():
    found = WORLD.diagnosed(replace(VIEW, pictures=(PICTURE, SECOND), cameras=(CAMERA, OTHER)))
    assert found.findings == ()
    assert found.poses == ()
    notes = " ".join(found.notes)
    assert "the arm is where `state` and the pose say" in notes
    assert "65 degrees wide, trained 52 to 85" in notes


@pytest.mark.parametrize(("offset_m", "deg"), [((0.0, -0.02, 0.02), 0.0), ((0.0, 0.0, 0.0), 3.0)])
def test_a_wrong_pose_is_found_and_the_right_one_suggested(offset_m, deg):
    pose = CAMERA.matrix
    pose[:3, 3] += offset_m
    pose[:3, :3] = turn((0.0, 0.6, 0.8), np.radians(deg)) @ pose[:3, :3]
    found = WORLD.diagnosed(view_of(pose))
    assert "extrinsics" in {one.code for one in found.findings}
    (suggested,) = found.poses
    better = np.array(suggested.pose)
    assert turn_deg(better[:3, :3] @ CAMERA.matrix[:3, :3].T) < 1.0
    # Where the arm is, both poses agree.
    arm = np.append(WORLD.body.spheres_at(STATE)[:, :3].mean(axis=0), 1.0)
    assert np.linalg.norm((better @ np.linalg.inv(pose) - CAMERA.matrix @ np.linalg.inv(pose)) @ arm) < 0.005


@pytest.mark.parametrize(
    ("code", "pose"),
    [
        ("inverted-pose", np.linalg.inv(CAMERA.matrix)),
        ("body-frame", CAMERA.matrix @ np.linalg.inv(OPTICAL_IN_BODY)),
        ("opengl-frame", CAMERA.matrix @ np.diag([1.0, -1.0, -1.0, 1.0])),
        ("upside-down", CAMERA.matrix @ np.diag([-1.0, -1.0, 1.0, 1.0])),
    ],
)
def test_another_convention_of_the_pose_is_named_and_undone(code, pose):
    found = WORLD.diagnosed(view_of(pose))
    assert code in {one.code for one in found.findings}
    np.testing.assert_allclose(np.array(found.poses[0].pose), CAMERA.matrix, atol=1e-9)


def test_a_picture_on_its_head_is_found_by_the_arm():
    assert "upside-down" in codes(replace(VIEW, pictures=(np.ascontiguousarray(PICTURE[::-1, ::-1]),)))


@pytest.mark.parametrize(("scale", "unit"), [(5.0, "0.0002"), (0.1, "0.01")])
def test_another_unit_of_depths_is_named(scale, unit):
    found = WORLD.diagnosed(replace(VIEW, pictures=(np.rint(PICTURE * scale).astype(np.uint16),)))
    (one,) = (one for one in found.findings if one.code == "depth-unit")
    assert unit in one.remedy


def test_a_camera_inside_the_arm_is_found():
    pose = CAMERA.matrix
    spheres = WORLD.body.spheres_at(STATE)
    pose[:3, 3] = spheres[np.argmax(spheres[:, 3]), :3]
    assert "camera-inside-arm" in codes(view_of(pose))


def test_an_arm_in_the_picture_without_state_is_found():
    assert "arm-in-picture" in codes(replace(VIEW, state=None))
    empty = DepthView((taken(CAMERA, None),), (CAMERA,))
    assert codes(empty) == set()


def test_a_state_whose_arm_is_out_of_view_warns_in_every_answer():
    past = DepthCamera.of_field(128, 128, 65.0, looking((0.7, 0.3, 1.0), (0.7, 0.9, 0.1)))
    view = DepthView((taken(past),), (past,), STATE)
    assert "arm-not-in-view" in codes(view)
    assert [one.code for one in WORLD.examine_picture(write_view(view)).findings] == ["arm-not-in-view"]
    without = write_view(replace(view, state=None))
    assert WORLD.examine_picture(without).findings == ()


def test_what_the_arm_carries_is_found():
    tool = WORLD.body.tool_frames([STATE])[0, :3, 3]
    carried = Obstacles.of((*OBSTACLES.boxes, box(tool - (0.0, 0.0, 0.03), (0.09, 0.09, 0.05))))
    near = DepthCamera.of_field(128, 128, 65.0, looking((0.9, 0.6, 0.8), (0.25, 0.0, 0.45)))
    assert codes(DepthView((taken(near),), (near,), STATE)) == set()
    assert codes(DepthView((taken(near, obstacles=carried),), (near,), STATE)) == {"arm-pixels-left"}


def test_an_arm_that_reads_nothing_and_a_covered_lens_are_found():
    holes = PICTURE.copy()
    with_arm = render_depth(OBSTACLES, CAMERA, WORLD.body.spheres_at(STATE))
    holes[with_arm != render_depth(OBSTACLES, CAMERA)] = 0
    assert "holes" in codes(replace(VIEW, pictures=(holes,)))
    covered = np.where(np.random.default_rng(0).random(PICTURE.shape) < 0.01, PICTURE, 0).astype(np.uint16)
    assert "blank" in codes(replace(VIEW, pictures=(covered,)))


def test_cameras_that_disagree_are_found_without_the_arm():
    pictures = (taken(CAMERA, None), taken(OTHER, None))
    right = DepthView(pictures, (CAMERA, OTHER))
    assert "cameras-disagree" not in codes(right)
    pose = OTHER.matrix
    pose[:3, 3] += (0.0, 0.0, 0.4)
    wrong = replace(right, cameras=(CAMERA, replace(OTHER, pose=pose_of(pose))))
    assert "cameras-disagree" in codes(wrong)


@pytest.mark.parametrize(
    ("code", "camera"),
    [
        ("field-of-view", DepthCamera.of_field(128, 128, 120.0, CAMERA.pose)),
        ("far-camera", DepthCamera.of_field(128, 128, 65.0, looking((2.6, 1.6, 1.4), (0.2, 0.0, 0.35)))),
        ("rolled", DepthCamera.of_field(128, 128, 65.0, looking((1.2, 0.9, 0.9), (0.2, 0.0, 0.35), 1.6))),
    ],
)
def test_cameras_unlike_training_are_in_the_warnings_of_every_answer(code, camera):
    found = WORLD.examine_picture(write_view(DepthView((taken(camera),), (camera,), STATE)))
    assert code in {one.code for one in found.findings}


def test_a_large_picture_is_diagnosed_as_a_small_one():
    large = CAMERA.resized(480, 480)
    view = DepthView((taken(large),), (large,), STATE)
    assert codes(view) == set()


def test_a_novelty_is_told_in_words():
    found = WORLD.diagnosed(VIEW)
    assert "more unusual than 40%" in found.with_novelty(0.4).notes[-1]
    assert [one.code for one in found.with_novelty(1.0).findings] == ["novel"]
    assert found.with_novelty(None) == found
    # An arm without shapes is not looked for.
    bare = replace(WORLD, body=replace(WORLD.body, parts=(), touching=()))
    assert bare.diagnosed(VIEW).poses == ()


def order_wxyz(matrix):
    x, y, z, w = quaternion_of(matrix[:3, :3])
    return quaternion_pose(matrix[:3, 3], (w, x, y, z))


@pytest.mark.parametrize(
    ("code", "view"),
    [
        ("quaternion-order", view_of(order_wxyz(CAMERA.matrix))),
        ("transposed-rotation", view_of(make_pose(CAMERA.matrix[:3, :3].T, CAMERA.matrix[:3, 3]))),
        ("mirrored-picture", replace(VIEW, pictures=(np.ascontiguousarray(PICTURE[:, ::-1]),))),
        ("joint-off", replace(VIEW, state=(STATE[0] + 0.9, *STATE[1:]))),
        ("joint-off", replace(VIEW, state=(STATE[0], STATE[1] + 0.2, *STATE[2:]))),
        ("base-height", view_of(CAMERA.matrix + np.array([[0, 0, 0, 0]] * 2 + [[0, 0, 0, 0.5]] + [[0] * 4]))),
    ],
)
def test_a_cause_is_named_beside_its_score(code, view):
    found = [one for one in WORLD.diagnosed(view).findings if one.code == code]
    assert found, WORLD.diagnosed(view)
    assert "as sent" in found[0].seen


def test_distances_along_the_ray_are_named_and_their_camera_is_not_blamed():
    along = PICTURE * np.linalg.norm(CAMERA.rays(), axis=-1)
    found = WORLD.diagnosed(replace(VIEW, pictures=(np.rint(along).astype(np.uint16),)))
    assert "ray-distance" in {one.code for one in found.findings}
    assert found.poses == ()


def test_a_state_that_is_off_suggests_no_pose():
    assert WORLD.diagnosed(replace(VIEW, state=(*STATE[:3], STATE[3] + 0.3, *STATE[4:]))).poses == ()
