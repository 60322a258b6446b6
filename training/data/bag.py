"""Recordings of ROS 2, read without ROS: messages, series by stamp, and the tf tree.

Only messages of five standard types are read, by built-in definitions; those of a recording are ignored. All
stamps are those of the messages' headers.
"""

import math
from array import array
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from cspace.errors import CspaceError, DatasetError, ImageError
from cspace.worlds.spatial.camera import decode_depth
from cspace.worlds.spatial.depth_files import METRES, rounded_mm
from cspace.worlds.spatial.poses import quaternion_pose

KINDS = (".mcap", ".db3")
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, JOINT_STATE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
# Depth images by their encoding: type of a pixel. REP 118 of ROS: whole numbers are mm, floats metres.
_DEPTH = {"16UC1": "u2", "32FC1": "f4"}
# In front of the PNG of a compressed depth image.
_HEADER_BYTES = 12
_QUATERNION_TOLERANCE, _FAR_M = 1e-2, 1e6


class Bag:
    """Recordings that are open, read message by message."""

    def __init__(self, readers: Sequence[Reader], name: str) -> None:
        self.name = name
        found: list[tuple[Reader, Any]] = [(reader, reader.connections) for reader in readers]
        # A damaged .db3 file has topics without a name.
        self._readers = [
            (reader, [one for one in ones if isinstance(one.topic, str)]) for reader, ones in found
        ]
        self._types = get_typestore(Stores.LATEST)
        self.topics = {one.topic: one.msgtype for _, connections in self._readers for one in connections}

    def of_type(self, *types: str) -> list[str]:
        """Topics whose messages are of a type."""
        return sorted(topic for topic, kind in self.topics.items() if kind in types)

    def count(self, topic: str) -> int:
        """How many messages a topic is said to have."""
        return sum(
            one.msgcount for _, connections in self._readers for one in connections if one.topic == topic
        )

    def messages(self, *topics: str) -> Iterator[tuple[str, Any]]:
        """Messages of topics with their topics, in the order in which they were recorded in each file.

        Raises:
            DatasetError: the recording cannot be read.
        """
        for reader, connections in self._readers:
            wanted = [
                one for one in connections if one.topic in topics and one.msgtype == self.topics[one.topic]
            ]
            # None asks for all.
            yield from self._read(reader, wanted) if wanted else ()

    def _read(self, reader: Reader, connections: Any) -> Iterator[tuple[str, Any]]:
        found = reader.messages(connections)
        while True:
            with _read_errors(self.name):
                item = next(found, None)
                if item is None:
                    return
                connection, _, data = item
                message = self._types.deserialize_cdr(data, connection.msgtype)
            yield connection.topic, message


@contextmanager
def opened(source: Path) -> Iterator[Bag]:
    """The messages of a ``.mcap`` or ``.db3`` file, or of those in a folder.

    Raises:
        DatasetError: there is none, one lies elsewhere, or it cannot be read.
    """
    with ExitStack() as stack:
        readers = []
        for path in _files(source):
            with _read_errors(source.name):
                readers.append(stack.enter_context(Reader(path)))
        with _read_errors(source.name):
            # By time: the names of the parts of a long recording end in _9, _10, ...
            readers.sort(key=lambda reader: reader.start_time)
        yield Bag(readers, source.name)


def _files(source: Path) -> list[Path]:
    found = [source]
    if source.is_dir():
        found = sorted(one for one in source.iterdir() if one.suffix in KINDS)
    inside = source.resolve()
    # The reader of .db3 takes a path for a part of a URI, in which some characters lead elsewhere.
    if not found or any(
        one.suffix not in KINDS
        or not one.is_file()
        or not one.resolve().is_relative_to(inside)
        or any(mark in str(one) for mark in "?#%")
        for one in found
    ):
        raise DatasetError(
            f"{source} is no recording",
            expected=f"a file {' or '.join(KINDS)}, or a folder of them without links to elsewhere; "
            "no ?, # or % in its path",
            got=", ".join(one.name for one in found)[:200] or "none",
            remedy="convert other recordings, and compressed ones, by rosbags-convert or ros2 bag convert",
        )
    return found


@contextmanager
def _read_errors(name: str) -> Iterator[None]:
    try:
        yield
    except (CspaceError, MemoryError):
        raise
    except Exception as error:
        # All, for there is no list of what the readers raise for bytes from outside.
        raise DatasetError(
            f"{name} cannot be read",
            expected="a complete recording of ROS 2",
            got=f"{type(error).__name__}: {error}"[:200],
        ) from error


class Series:
    """Rows of numbers by stamp."""

    def __init__(self, width: int) -> None:
        self._stamps, self._rows, self._width = array("q"), array("d"), width

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """One more."""
        self._stamps.append(stamp_ns)
        self._rows.extend(row)

    @cached_property
    def sorted(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Stamps (n,) in order, and rows (n, width); nothing is added any more."""
        stamps, rows = np.array(self._stamps, np.int64), np.array(self._rows)
        order = np.argsort(stamps, kind="stable")
        return stamps[order], rows.reshape(len(stamps), self._width)[order]

    def nearest(self, stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
        """The row (width,) of the nearest stamp; None where that is farther away."""
        stamps, rows = self.sorted
        after = int(np.searchsorted(stamps, stamp_ns))
        gaps = {
            abs(int(stamps[near]) - stamp_ns): near for near in (after - 1, after) if 0 <= near < len(stamps)
        }
        if not gaps or min(gaps) > within_ns:
            return None
        return np.asarray(rows[gaps[min(gaps)]])


@dataclass(slots=True)
class _Edge:
    """A frame in its parent's: transforms, and what is wrong with one of them."""

    parent: str
    wrong: str = ""
    fixed: NDArray[np.float64] | None = None
    moving: Series = field(default_factory=lambda: Series(7))


class TransformTree:
    """The tf tree."""

    def __init__(self, base: str) -> None:
        self._edges: dict[str, _Edge] = {}
        self._base = base.lstrip("/")

    def add(self, transform: Any, *, static: bool) -> None:
        """One more transform; what is wrong with it counts where the frame is used."""
        child, parent = transform.child_frame_id.lstrip("/"), transform.header.frame_id.lstrip("/")
        edge = self._edges.setdefault(child, _Edge(parent))
        place, turn = transform.transform.translation, transform.transform.rotation
        row = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        norm = math.hypot(*row[3:])
        if edge.parent != parent or not (
            abs(norm - 1.0) <= _QUATERNION_TOLERANCE and np.abs(row).max() < _FAR_M
        ):
            edge.wrong = f"parents {edge.parent!r} and {parent!r}, a norm of {norm:.3g}, {row}"
        elif static:
            edge.fixed = np.array(row)
        else:
            edge.moving.add(stamp_of(transform.header), row)

    def pose(self, frame: str, stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
        """A frame in the base's, (4, 4); None where a moving transform has no such stamp.

        Raises:
            DatasetError: no chain of transforms leads from the one to the other.
        """
        ours, bases = self._chain(frame.lstrip("/")), self._chain(self._base)
        shared = next((one for one in ours if one in bases), None)
        if shared is None:
            frames = sorted({*self._edges, *(one.parent for one in self._edges.values())})
            raise DatasetError(
                f"no transforms lead from {frame!r} to the base {self._base!r}"[:200],
                expected="both in one tf tree",
                got=f"frames {', '.join(frames)}"[:300],
                remedy="name the robot's base by --base",
            )
        up = self._matrix(ours[: ours.index(shared)], stamp_ns, within_ns)
        down = self._matrix(bases[: bases.index(shared)], stamp_ns, within_ns)
        return None if up is None or down is None else np.linalg.inv(down) @ up

    def _chain(self, frame: str) -> list[str]:
        found = [frame]
        while found[-1] in self._edges:
            found.append(self._edges[found[-1]].parent)
            if found[-1] in found[:-1]:
                raise DatasetError("the tf tree has a loop", expected="a tree", got=" > ".join(found)[:200])
        return found

    def _matrix(self, frames: Sequence[str], stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
        """From the first frame's coordinates to those of the last one's parent."""
        found = np.eye(4)
        for frame in frames:
            edge = self._edges[frame]
            if edge.wrong:
                raise DatasetError(
                    f"a transform of the frame {frame!r} does not fit"[:200],
                    expected=f"one parent, numbers below {_FAR_M:g} m and a quaternion with a norm of 1",
                    got=edge.wrong[:200],
                )
            row = edge.fixed if edge.fixed is not None else edge.moving.nearest(stamp_ns, within_ns)
            if row is None:
                return None
            found = quaternion_pose(row[:3], row[3:]) @ found
        return found


def stamp_of(header: Any) -> int:
    """The stamp of a message's header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def is_depth(message: Any) -> bool:
    """Whether a message of an image, compressed or not, says that it holds depths."""
    if hasattr(message, "encoding"):
        return message.encoding in _DEPTH
    return "compressedDepth" in message.format


def depth_mm(message: Any) -> NDArray[np.uint16]:
    """The depths (H, W) of a message, mm.

    Raises:
        ImageError: it is no depth image, or of a compression that is not read.
    """
    if not hasattr(message, "encoding"):
        data = message.data.tobytes()[_HEADER_BYTES:]
        if not message.format.startswith("16UC1") or "compressedDepth" not in message.format:
            raise ImageError(
                "the compressed image is not read",
                expected="16UC1; compressedDepth png",
                got=repr(message.format)[:100],
                remedy="record the raw depth topic, or republish it raw: ros2 run image_transport republish",
            )
        return decode_depth(data)
    kind = _DEPTH.get(message.encoding)
    size = 0 if kind is None else message.width * int(kind[1])
    if kind is None or message.step < size or message.height * message.step != len(message.data):
        raise ImageError(
            "the image is no depth image",
            expected=f"the encoding {' or '.join(_DEPTH)}, and rows of step bytes",
            got=f"{message.encoding[:30]!r}, {message.width} x {message.height}, step {message.step}, "
            f"{len(message.data)} bytes",
        )
    rows = message.data.reshape(message.height, message.step)[:, :size]
    depth = np.ascontiguousarray(rows).view((">" if message.is_bigendian else "<") + kind)
    return rounded_mm(depth, METRES) if kind == "f4" else depth.astype(np.uint16)


def camera_info(info: Any) -> dict[str, Any]:
    """The parts of a CameraInfo that say how its pictures are read, as plain values."""
    return {
        "width": int(info.width),
        "height": int(info.height),
        "distortion_model": info.distortion_model,
        "d": info.d.tolist(),
        "k": info.k.tolist(),
        "binning_x": int(info.binning_x),
        "binning_y": int(info.binning_y),
        "roi": {"x_offset": int(info.roi.x_offset), "y_offset": int(info.roi.y_offset)},
    }
