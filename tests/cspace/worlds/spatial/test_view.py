"""View files: pictures, cameras and state as one untrusted file."""

import numpy as np
import pytest

from cspace.errors import ImageError
from cspace.view_file import pack_view, unpack_view
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, looking
from cspace.worlds.spatial.view import DepthView, read_view, write_view
from tests.cspace.worlds.spatial.test_robots import PANDA, READY

STATE = tuple(READY[0])


def camera(width=32, height=24, side=0.5):
    return DepthCamera.of_field(width, height, 70.0, looking((1.2, side, 0.8), (0.4, 0.0, 0.3)))


def camera_values():
    values = camera().to_dict()
    return {name: values[name] for name in ("fx", "fy", "cx", "cy", "pose")}


def picture(height=24, width=32, least=700):
    return (least + np.arange(height * width).reshape(height, width)).astype(np.uint16)


@pytest.fixture
def view():
    return DepthView((picture(), picture(48, 64)), (camera(), camera(64, 48, -0.5)), STATE)


def test_what_is_written_is_read(view):
    for one in (view, DepthView(view.pictures[:1], view.cameras[:1])):
        found = read_view(write_view(one), PANDA)
        assert found.cameras == one.cameras
        assert found.state == one.state
        assert all(np.array_equal(a, b) for a, b in zip(found.pictures, one.pictures, strict=True))
        assert write_view(found) == write_view(one)


@pytest.mark.parametrize(
    "state", [[0.0] * 6, "home", [99.0, *STATE[1:]], [*STATE[:6], "0"], [[0.0] * 6], [[STATE]]]
)
def test_a_state_that_the_arm_cannot_have_is_refused(state):
    data = pack_view([encode_depth(picture())], [camera_values()], state)
    with pytest.raises(ImageError):
        read_view(data, PANDA)


def test_pictures_and_cameras_are_as_many_as_each_other_and_at_most_four():
    for pictures, cameras in ((0, 0), (1, 2), (2, 1), (5, 5)):
        with pytest.raises(ImageError):
            unpack_view(pack_view([b"PNG"] * pictures, [camera_values()] * cameras, None))
    with pytest.raises(ImageError):
        pack_view([b"PNG"], [["x" * 20_000]], None)


def test_bytes_that_are_no_view_are_refused(view):
    data = write_view(view)
    line, _, rest = data.partition(b"\n")
    for wrong in (
        b"",
        data[:5],
        encode_depth(picture()),
        b"cspace-view 2 " + data[14:],
        line,
        line + b"\n",
        data[:-1],
        data + b" ",
        line.replace(b'"state"', b'"State"') + b"\n" + rest,
        b"cspace-view 1 [1]\n",
        b"cspace-view 1 {\n",
        b'cspace-view 1 {"pictures":[-1,1],"cameras":[1,1],"state":null}\n',
        b'cspace-view 1 {"pictures":{},"cameras":[],"state":null}\n',
        b"cspace-view 1 " + b" " * 20_000 + b"\n",
    ):
        with pytest.raises(ImageError):
            read_view(wrong, PANDA)
