"""Cameras on the arm, and an arm that moves between pictures."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import ImageError
from cspace.view_file import pack_view
from cspace.world import ARM_IN_PICTURE
from cspace.worlds.spatial.camera import OPTICAL_IN_BODY, camera_pose, encode_depth, looking
from cspace.worlds.spatial.poses import make_pose, turned
from cspace.worlds.spatial.view import DepthView
from tests.cspace.worlds.spatial.test_camera_forms import placed
from tests.cspace.worlds.spatial.test_diagnosis import CAMERA, OTHER, PICTURE, STATE, WORLD, codes, taken

ARM = WORLD.body
MOVED = (STATE[0] + 0.9, STATE[1] + 0.3, *STATE[2:])
STATES = (STATE, MOVED)
# Beside the flange, towards what the hand works on.
ON_LINK = make_pose(turned(0.4, 0.1), (0.12, 0.0, 0.06))
PINHOLE = {"fx": 100.0, "fy": 100.0, "cx": 63.5, "cy": 47.5}
DEPTH = np.full((96, 128), 900, np.uint16)
DEPTH[30:60, 40:90] = 500


def camera(pose, **keys):
    return PINHOLE | {"pose": pose if isinstance(pose, dict) else pose.tolist()} | keys


def read(cameras, state):
    return WORLD.read_picture(pack_view([encode_depth(DEPTH)] * len(cameras), cameras, state))


def test_cameras_on_links_are_where_the_states_of_their_pictures_put_them():
    fixed = looking((1.3, 0.6, 0.9), (0.4, 0.0, 0.3))
    tool = np.linalg.inv(ARM.tool.matrix()) @ ON_LINK
    body = json.loads(json.dumps(placed(ON_LINK @ np.linalg.inv(OPTICAL_IN_BODY))))
    links = [
        camera(ON_LINK, link="panda_link7"),
        camera(body, link="panda_joint7", frame="body"),
        camera(tool, link="tool", stamp_s=12.5),
        camera(fixed),
    ]
    states = [*STATES, MOVED, None]
    frames = [ARM.link_frames([state])[0, -1] for state in STATES]
    by_hand = [
        camera(frames[0] @ ON_LINK),
        camera(frames[1] @ np.array(camera_pose({"pose": body, "frame": "body"}))),
        camera(ARM.tool_frames([MOVED])[0] @ tool),
        camera(fixed),
    ]
    np.testing.assert_array_equal(read(links, states), read(by_hand, states))
    still = read([camera(ON_LINK, link="panda_link7")], list(STATE))
    np.testing.assert_array_equal(still, read([by_hand[0]], list(STATE)))
    assert (still != read([camera(ON_LINK, link="panda_link7")], list(MOVED))).any()


@pytest.mark.parametrize(
    ("link", "state"),
    [
        ("panda_link7", None),
        ("panda_link7", [None]),
        (7, STATE),
        ("camera_link", STATE),
        ("panda_hand", STATE),
        ("panda_link0", STATE),
        ("panda_link7", [STATE, STATE]),
    ],
)
def test_a_camera_on_no_link_or_without_its_state_is_refused(link, state):
    with pytest.raises(ImageError):
        read([camera(ON_LINK, link=link)], state)


def test_the_self_filter_takes_the_state_of_each_picture():
    view = DepthView((taken(CAMERA, STATE), taken(OTHER, MOVED)), (CAMERA, OTHER), STATES)
    alone = [
        WORLD.observed(DepthView(view.pictures[one : one + 1], view.cameras[one : one + 1], STATES[one]))
        for one in (0, 1)
    ]
    both = pack_view([encode_depth(one) for one in view.pictures], list(map(told, view.cameras)), STATES)
    np.testing.assert_array_equal(WORLD.read_picture(both), np.minimum(*alone))
    assert WORLD.diagnosed(view).findings == ()
    # Where the arm stood in either picture, it is no obstacle.
    for state in STATES:
        assert codes(replace(view, state=state)) & {"arm-elsewhere", "arm-pixels-left", "joint-off"}
    examined = WORLD.examine_picture(both)
    assert (examined.findings, examined.without_state) == ((), False)
    partly = WORLD.examined(replace(view, state=(STATE, None)))
    assert partly.without_state
    assert [one.pictures for one in partly.findings if one.code == ARM_IN_PICTURE] == [(1,)]


def test_a_camera_that_is_off_on_its_link_gets_a_pose_in_the_base():
    frame, off = ARM.frame_of("panda_link4", STATE), CAMERA.matrix
    off[:3, 3] += (0.03, 0.0, 0.0)
    values = told(CAMERA) | {"pose": (np.linalg.inv(frame) @ off).tolist(), "link": "panda_link4"}
    found = WORLD.diagnosis(pack_view([encode_depth(PICTURE)], [values], list(STATE)))
    (suggested,) = found.poses
    assert np.linalg.norm(np.array(suggested.pose)[:3, 3] - CAMERA.matrix[:3, 3]) < 0.01
    assert any("the suggested pose is in the base frame" in note for note in found.notes)


def told(camera):
    return {name: value for name, value in camera.to_dict().items() if name not in ("width", "height")}
