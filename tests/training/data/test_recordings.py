"""Recordings of ROS 2, written by rosbags: what becomes of pictures, cameras, joint states and transforms."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from cspace.dataset import open_dataset
from cspace.errors import DatasetError, StorageError
from cspace.view_file import pack_view, unpack_view
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.camera import encode_depth, read_pinhole
from cspace.worlds.spatial.visibility import arm_depth_m
from tests.cspace.worlds.spatial.test_camera_forms import (
    BODY,
    CAMERA_VALUES,
    DEPTH,
    INFO,
    OPTICAL_TO_BODY,
    quaternion,
)
from tests.space_bundle import WORLD
from tests.training.worker_peak import worker_peak
from training.data.__main__ import main
from training.data.recordings import RecordingOptions, import_recording

TYPES = get_typestore(Stores.ROS2_HUMBLE)
NAMES, STATE = WORLD.space.names, tuple(ready_rad(WORLD.body).tolist())
START_NS = 1_700_000_000 * 10**9
FRAME, BASE = "camera_depth_optical_frame", "panda_link0"
OPTIONS = RecordingOptions(base=BASE, every_s=0.0)


def made(kind, **values):
    return TYPES.types[kind](**values)


def header(seconds, frame=FRAME):
    at = START_NS + round(seconds * 1e9)
    stamp = made("builtin_interfaces/msg/Time", sec=at // 10**9, nanosec=at % 10**9)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def image(seconds, depth=DEPTH, encoding="16UC1", frame=FRAME, *, big=False, pad=0):
    rows = np.ascontiguousarray(depth.astype(depth.dtype.newbyteorder(">" if big else "<")))
    rows = np.pad(rows.view(np.uint8).reshape(len(depth), -1), ((0, 0), (0, pad)))
    height, step = rows.shape
    return made(
        "sensor_msgs/msg/Image", header=header(seconds, frame), height=height, width=depth.shape[1],
        encoding=encoding, is_bigendian=int(big), step=step, data=rows.ravel(),
    )  # fmt: skip


def compressed(seconds, words="16UC1; compressedDepth png"):
    data = np.frombuffer(bytes(12) + encode_depth(DEPTH), np.uint8)
    return made("sensor_msgs/msg/CompressedImage", header=header(seconds), format=words, data=data)


def info(seconds, **changes):
    values = INFO | changes
    roi = made("sensor_msgs/msg/RegionOfInterest", **values["roi"])
    arrays = {name: np.array(values[name], np.float64) for name in ("d", "k", "r", "p")}
    same = {name: values[name] for name in ("height", "width", "distortion_model", "binning_x", "binning_y")}
    return made("sensor_msgs/msg/CameraInfo", header=header(seconds), roi=roi, **same, **arrays)


def joints(seconds, state=STATE, names=NAMES):
    names, empty = ["finger", *names][::-1], np.empty(0)
    position = np.array([*state[::-1], 0.04])
    return made(
        "sensor_msgs/msg/JointState", header=header(seconds), name=names, position=position, velocity=empty,
        effort=empty,
    )  # fmt: skip


def transforms(seconds, *edges):
    """A message of edges: parent, child and a matrix."""
    found = []
    for parent, child, matrix in edges:
        x, y, z = (float(one) for one in matrix[:3, 3])
        turn = dict(zip("xyzw", map(float, quaternion(matrix)), strict=True))
        found.append(
            made(
                "geometry_msgs/msg/TransformStamped",
                header=header(seconds, parent),
                child_frame_id=child,
                transform=made(
                    "geometry_msgs/msg/Transform",
                    translation=made("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                    rotation=made("geometry_msgs/msg/Quaternion", **turn),
                ),
            )
        )
    return made("tf2_msgs/msg/TFMessage", transforms=found)


UP = np.eye(4)
UP[2, 3] = 0.7
# The base stands on a table; the camera's body, whose optical frame turns it, hangs from the world.
CAMERA = ("world", "camera_link", UP @ BODY)
STATIC = (("world", BASE, UP), CAMERA, ("camera_link", FRAME, np.linalg.inv(OPTICAL_TO_BODY)))
KINDS = {
    "image": "sensor_msgs/msg/Image", "compressed": "sensor_msgs/msg/CompressedImage",
    "info": "sensor_msgs/msg/CameraInfo", "joints": "sensor_msgs/msg/JointState",
    "tf": "tf2_msgs/msg/TFMessage", "tf_static": "tf2_msgs/msg/TFMessage",
}  # fmt: skip


@dataclass
class Recorder:
    """Messages by topic: their kind, and each with its time in s."""

    topics: dict = field(default_factory=dict)

    def add(self, topic, kind, *messages):
        self.topics.setdefault(topic, (kind, []))[1].extend(messages)
        return self

    def write(self, folder, plugin=StoragePlugin.MCAP, mode=CompressionMode.NONE):
        writer = Writer(folder, version=9, storage_plugin=plugin)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            for topic, (kind, messages) in self.topics.items():
                connection = writer.add_connection(topic, KINDS[kind], typestore=TYPES)
                for message in messages:
                    stamp = (message.transforms[0] if kind.startswith("tf") else message).header.stamp
                    data = TYPES.serialize_cdr(message, KINDS[kind])
                    writer.write(connection, stamp.sec * 10**9 + stamp.nanosec, data)
        return folder


def usual(*, pictures=True, states=True, static=STATIC):
    """Three pictures in 0.2 s, infos beside them, and joint states every 10 ms in which a joint turns."""
    found = Recorder().add("/tf_static", "tf_static", transforms(0.0, *static))
    if pictures:
        found.add("/camera/depth/image_rect_raw", "image", *(image(0.1 * n) for n in range(3)))
    found.add("/camera/depth/camera_info", "info", *(info(0.1 * n) for n in range(3)))
    if states:
        found.add("/joint_states", "joints", *(joints(0.01 * n, turned(n)) for n in range(21)))
    return found


def turned(number):
    return (STATE[0] + 0.005 * number, *STATE[1:])


def expected(state, pose=CAMERA_VALUES["pose"]):
    return WORLD.read_picture(pack_view([encode_depth(DEPTH)], [CAMERA_VALUES | {"pose": pose}], list(state)))


def only_file(folder, ending):
    (found,) = folder.glob(f"*{ending}")
    return found


@pytest.mark.parametrize("source", ["mcap of zstd", "db3", "a folder"])
def test_a_recording_becomes_views_and_a_data_set(tmp_path, capsys, source):
    bag = usual().write(
        tmp_path / "bag",
        StoragePlugin.SQLITE3 if source == "db3" else StoragePlugin.MCAP,
        CompressionMode.STORAGE if source == "mcap of zstd" else CompressionMode.NONE,
    )
    path = bag if source == "a folder" else only_file(bag, source.split()[0])
    arguments = [str(path), str(tmp_path / "out"), "--arm", "panda", "--base", BASE, "--every", "0.05"]
    # It is written although the picture shows no arm, and that is told.
    assert main(["import-recording", *arguments]) == 3
    told = capsys.readouterr().out
    assert "views           3" in told
    assert "verdict         3: arm-elsewhere, as " in told
    views = sorted((tmp_path / "out" / "views").iterdir())
    assert [one.name for one in views] == [f"{n:04d}-{START_NS + n * 10**8}.view" for n in range(3)]
    dataset = open_dataset(tmp_path / "out" / "data", verify=True)
    assert (dataset.world.body, dataset.world.scenes) == (WORLD.body, None)
    states = [unpack_view(one.read_bytes()).state for one in views]
    np.testing.assert_array_equal(states, [turned(10 * number) for number in range(3)])
    np.testing.assert_array_equal(dataset.images[1], expected(turned(10)))
    # Each joint state is free in the picture that it was nearest to.
    assert [len(dataset.free_of(number)) for number in range(3)] == [5, 10, 6]
    np.testing.assert_allclose(dataset.free_of(1)[0], turned(5), atol=1e-6)


def test_views_in_which_the_arm_is_where_it_should_be_pass(tmp_path):
    camera, _ = read_pinhole(CAMERA_VALUES, DEPTH.shape)
    arm_m = arm_depth_m(camera, WORLD.body.spheres_at(STATE))
    shown = np.where(np.isfinite(arm_m), 1e3 * np.minimum(arm_m, 5.0), 2500.0).astype(np.uint16)
    bag = usual(pictures=False).add("/camera/depth/image_rect_raw", "image", image(0.0, shown))
    found = import_recording(bag.write(tmp_path / "bag"), tmp_path / "out", world=WORLD, options=OPTIONS)
    assert (found.diagnosed, found.wrong) == (1, 0)


def test_joint_states_come_in_parts_and_with_a_prefix(tmp_path):
    names = [f"left_{name}" for name in NAMES]
    parts = [joints(0.001, STATE[:4], names[:4]), joints(0.002, STATE[4:], names[4:])]
    # Half of a state that is long gone is not joined with a later one.
    parts = [joints(-0.2, turned(9)[:4], names[:4]), joints(-0.1, STATE[4:], names[4:]), *parts]
    bag = usual(states=False).add("/joint_states", "joints", *parts).write(tmp_path / "bag")
    refused(tmp_path, bag, "no joint state of the robot.*got joints.*left_panda_joint1.*--joint-prefix")
    options = RecordingOptions(base=BASE, every_s=0.0, joint_prefix="left_", tolerance_s=0.03)
    found = import_recording(bag, tmp_path / "done", world=WORLD, options=options)
    assert found.views == 1
    (view,) = (tmp_path / "done" / "views").iterdir()
    np.testing.assert_array_equal(unpack_view(view.read_bytes()).state, STATE)


@pytest.mark.parametrize(("topic", "is_rectified"), [("image_rect", True), ("image_raw", False)])
def test_a_rectified_picture_has_the_camera_of_p_and_no_distortion(tmp_path, topic, is_rectified):
    p = [50.0, 0.0, 30.0, 0.0, 0.0, 51.0, 20.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    bag = Recorder().add("/tf_static", "tf_static", transforms(0.0, *STATIC))
    bag.add("/camera/depth/camera_info", "info", info(0.0, p=p, d=[0.1, 0.0, 0.0, 0.0, 0.0]))
    bag.add(f"/camera/depth/{topic}", "image", image(0.0))
    import_recording(bag.write(tmp_path / "bag"), tmp_path / "out", options=OPTIONS)
    (view,) = (tmp_path / "out" / "views").iterdir()
    seen = unpack_view(view.read_bytes()).cameras[0]["camera_info"]
    projected = ([50.0, 0.0, 30.0, 0.0, 51.0, 20.0, 0.0, 0.0, 1.0], [])
    assert ((seen["k"], seen["d"]) == projected) is is_rectified


@pytest.mark.parametrize("form", ["floats", "big-endian with padded rows", "compressed"])
def test_every_depth_encoding_is_the_same_picture(tmp_path, form):
    bag, topic = usual(pictures=False), "/camera/depth/image_rect_raw"
    if form == "floats":
        bag.add(topic, "image", image(0.0, np.where(DEPTH == 0, np.nan, DEPTH / 1e3).astype("f4"), "32FC1"))
    elif form == "compressed":
        bag.add(f"{topic}/compressedDepth", "compressed", compressed(0.0))
    else:
        bag.add(topic, "image", image(0.0, big=True, pad=10))
    colour = np.zeros((48, 64), np.uint8)
    bag.add("/camera/color/image_raw", "image", image(0.0, colour, "mono8"))
    bag.add("/camera/color/camera_info", "info", info(0.0, width=1, height=1))
    import_recording(bag.write(tmp_path / "bag"), tmp_path / "out", options=OPTIONS)
    (view,) = (tmp_path / "out" / "views").iterdir()
    file = unpack_view(view.read_bytes())
    assert file.state is None
    assert file.pictures == [encode_depth(DEPTH)]
    assert not (tmp_path / "out" / "data").exists()


def test_the_parts_of_a_long_recording_are_one_in_the_order_of_their_times(tmp_path):
    (tmp_path / "parts").mkdir()
    later = Recorder().add("/camera/depth/image_rect_raw", "image", *(image(0.3 + 0.1 * n) for n in range(3)))
    for name, bag in (("bag_9", usual(states=False)), ("bag_10", later)):
        only_file(bag.write(tmp_path / name), ".mcap").rename(tmp_path / "parts" / f"{name}.mcap")
    assert import_recording(tmp_path / "parts", tmp_path / "out", options=OPTIONS).views == 6


def test_moving_transforms_and_joint_states_are_those_of_the_pictures_stamp(tmp_path):
    bag = usual(states=False, static=(STATIC[0], STATIC[2]))
    poses = []
    for number in range(3):
        moved = CAMERA[2].copy()
        moved[0, 3] += 0.05 * number
        poses.append(moved)
        bag.add("/tf", "tf", transforms(0.1 * number + 0.01, (*CAMERA[:2], moved)))
    # Of the second picture no joint state is near.
    bag.add("/joint_states", "joints", joints(-0.04), joints(0.24, turned(20)), joints(0.001, turned(1)))
    found = import_recording(bag.write(tmp_path / "bag"), tmp_path / "out", world=WORLD, options=OPTIONS)
    assert (found.views, dict(found.skipped)) == (2, {"no joint state within 0.05 s": 1})
    dataset = open_dataset(tmp_path / "out" / "data", verify=True)
    for place, (number, state) in enumerate(((0, turned(1)), (2, turned(20)))):
        pose = np.linalg.inv(UP) @ poses[number] @ STATIC[2][2]
        np.testing.assert_array_equal(dataset.images[place], expected(state, pose.tolist()))
    strict = RecordingOptions(base=BASE, every_s=0.0, tolerance_s=0.005)
    with pytest.raises(DatasetError, match=r"3 times no moving transform within 0\.005 s"):
        import_recording(tmp_path / "bag", tmp_path / "none", world=WORLD, options=strict)


def test_pictures_that_cannot_be_read_are_counted_by_their_reason(tmp_path):
    bag = usual().add("/camera/depth/image_rect_raw", "image", image(0.3, np.zeros_like(DEPTH)))
    bag.add("/camera/depth/image_rect_raw", "image", image(0.4, DEPTH[:30]))
    bag.add("/joint_states", "joints", joints(0.3), joints(0.4))
    found = import_recording(bag.write(tmp_path / "bag"), tmp_path / "out", world=WORLD, options=OPTIONS)
    assert found.views == 3
    none, other = sorted(found.skipped, key=len)
    assert none == "no reading"
    assert "camera info is of another picture" in other
    few = RecordingOptions(base=BASE, every_s=0.15, most=1)
    assert import_recording(tmp_path / "bag", tmp_path / "few", options=few).views == 1


def refused(tmp_path, bag, message, world=WORLD, **options):
    written = bag if not isinstance(bag, Recorder) else bag.write(tmp_path / "bag")
    with pytest.raises(DatasetError, match=message):
        import_recording(
            written, tmp_path / "out", world=world, options=RecordingOptions(**{"base": BASE} | options)
        )
    assert [one for one in tmp_path.iterdir() if one.name.startswith((".write", "out"))] == []


def test_two_pictures_of_one_time_are_one(tmp_path):
    bag = usual(pictures=False)
    bag.add("/camera/depth/image_rect_raw", "image", image(0.1), image(0.1), image(0.2))
    found = import_recording(bag.write(tmp_path / "bag"), tmp_path / "out", world=WORLD, options=OPTIONS)
    assert found.views == 2


def test_another_camera_robot_or_compression_is_refused_by_its_names(tmp_path):
    other = "/second/depth/image_rect_raw"
    for number, (bag, message, options) in enumerate(
        (
            (usual(), "lead from 'camera_depth_.*' to the base 'no'.*world.*--base", {"base": "no"}),
            (usual().add(other, "image", image(0.0)), "no topic, or several, of depth images.*second", {}),
            (usual(), "--depth names.*image_rect_raw", {"depth": "/wrong"}),
            (usual(pictures=False), "no topic, or several, of depth images.*got none", {}),
            (usual(states=False), "no topic, or several, of joint states.*got none", {}),
            (usual(static=(*STATIC, ("camera_link", BASE, UP))), "two parents.*'world' and", {}),
            (usual(static=(("a", FRAME, UP), (FRAME, "a", UP))), "no transforms lead", {}),
            (usual(static=(*STATIC[:2], ("camera_link", FRAME, 0.0 * UP))), "no transforms lead", {}),
        )
    ):  # fmt: skip
        place = tmp_path / str(number)
        place.mkdir()
        refused(place, bag, message, **options)
    bag = usual(pictures=False)
    bag.add("/camera/depth/z", "compressed", compressed(0.0, "32FC1; compressedDepth png"))
    (tmp_path / "z").mkdir()
    refused(tmp_path / "z", bag, "no complete picture.*got '32FC1; compressedDepth png'.*raw depth topic")
    bag = usual(states=False).add("/joint_states", "joints", joints(0.0, names=[f"j{n}" for n in range(7)]))
    refused(tmp_path, bag, "joints panda_joint1.*got joints finger, j0")


def test_files_that_are_no_recordings_are_refused(tmp_path):
    (tmp_path / "text.mcap").write_text("no recording")
    refused(tmp_path, tmp_path / "text.mcap", r"text\.mcap cannot be read; expected a complete recording")
    refused(tmp_path, tmp_path / "away.mcap", "is no recording")
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    refused(tmp_path, tmp_path / "old.bag", "rosbags-convert")
    data = only_file(usual().write(tmp_path / "there"), ".mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    refused(tmp_path, tmp_path / "cut.mcap", "cannot be read")


@pytest.mark.slow
def test_a_recording_of_a_million_frames_ends_within_the_limit_of_memory(tmp_path):
    recorder = usual()
    names = [transforms(0.0, *[("world", f"{part}_{n}", UP) for n in range(7000)]) for part in range(2)]
    for message in names * 20:
        recorder.add("/tf", "tf", message)
    bag = recorder.write(tmp_path / "bag", mode=CompressionMode.STORAGE)
    command = ["import-recording", str(bag), str(tmp_path / "out"), "--base", BASE, "--time-limit=20"]
    _, peak_bytes = worker_peak("training.data", *command)
    # With the libraries.
    assert peak_bytes < 1.8 * 2**30


def test_options_of_an_import_are_checked(tmp_path, capsys):
    bag = usual().write(tmp_path / "bag")
    assert main(["import-recording", str(bag), str(tmp_path / "out"), "--most", "0"]) == 2
    assert "the import's options: most does not fit" in capsys.readouterr().err
    (tmp_path / "out").mkdir()
    with pytest.raises(StorageError, match="exists"):
        import_recording(bag, tmp_path / "out", options=OPTIONS)
