"""Import of recordings of ROS 2, without ROS: view files, and a data set of the joint states.

All stamps are those of the messages' headers. A recording is read in a worker that the kernel bounds
(:mod:`cspace.bounded`), so nothing here counts what it holds.
"""

import argparse
import logging
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from cspace.dataset import write_dataset
from cspace.errors import ConfigError, CspaceError, DatasetError, ImageError, ScenarioError, StorageError
from cspace.files import replacing
from cspace.space import JointSpace
from cspace.strict_json import refused
from cspace.view_file import pack_view
from cspace.world import Finding
from cspace.worlds.spatial.camera import decode_depth, encode_depth, in_range, read_pinhole
from cspace.worlds.spatial.diagnosis import ELSEWHERE
from cspace.worlds.spatial.hypotheses import HYPOTHESES
from cspace.worlds.spatial.poses import quaternion_pose
from cspace.worlds.spatial.view import METRES, rounded_mm
from cspace.worlds.spatial.world import SpatialWorld, add_options, described
from services.commands import Progress, finite

_LOG = logging.getLogger(__name__)
KINDS = (".mcap", ".db3")
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, JOINT_STATE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
# Depth images by their encoding: type of a pixel. REP 118 of ROS: whole numbers are mm, floats metres.
_DEPTH = {"16UC1": "u2", "32FC1": "f4"}
# In front of the PNG of a compressed depth image.
_HEADER_BYTES = 12
_QUATERNION_TOLERANCE, _FAR_M = 1e-2, 1e6
# Views that are diagnosed, 2 s each.
_DIAGNOSED = 8
_WRONG = {*HYPOTHESES, ELSEWHERE}


class RecordingOptions(BaseModel, frozen=True):
    """How a recording is read."""

    base: str = Field("base_link", description="tf frame of the robot's base")
    depth: str | None = Field(None, description="topic of the depth images; default the only one")
    camera_info: str | None = Field(None, description="topic of their cameras; default the one beside them")
    joint_states: str | None = Field(None, description="topic of the joint states; default the only one")
    joint_prefix: str = Field("", description="what stands in front of the robot's names of joints")
    every_s: float = Field(1.0, ge=0.0, description="least time between pictures, s")
    tolerance_s: float = Field(
        0.05, ge=0.0, description="how far the stamps of picture, joint state and transforms may differ, s"
    )
    most: int = Field(100, ge=1, le=1000, description="pictures")
    time_limit_s: float = Field(600.0, gt=0.0, description="for the import, s")


@dataclass(frozen=True, slots=True, eq=False)
class RecordedView:
    """A complete picture of a recording.

    ``state`` (d,) rad and ``image``, the picture as the robot's world reads it, are None where no robot is
    known.
    """

    stamp_ns: int
    state: tuple[float, ...] | None
    image: NDArray[np.uint8] | None


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """What an import wrote: ``views`` and, where a robot is known, ``data`` in a folder.

    ``skipped`` counts pictures that were left out by the reason. Where a robot is known, ``diagnosed`` views
    are looked at closely: ``findings`` are theirs, and in ``wrong`` of them the arm is not where it should
    be. ``digest`` is the data set's.
    """

    folder: Path
    views: int
    skipped: Mapping[str, int]
    diagnosed: int
    findings: tuple[Finding, ...]
    wrong: int
    digest: str | None

    def __str__(self) -> str:
        lines = [f"{self.folder}", f"  views           {self.views}"]
        lines += [f"  skipped         {count}: {reason}" for reason, count in sorted(self.skipped.items())]
        if self.diagnosed:
            lines.append(f"  diagnosed       {self.diagnosed}: arm in another place in {self.wrong}")
        first = {one.code: one.seen for one in reversed(self.findings)}
        counts = sorted(Counter(one.code for one in self.findings).items())
        lines += [f"  verdict         {count}: {code}, as {first[code]}" for code, count in counts]
        return "\n".join(lines + ([f"  digest          {self.digest}"] if self.digest else []))


def import_recording(
    source: Path, folder: Path, *, world: SpatialWorld | None = None, options: RecordingOptions | None = None
) -> Imported:
    """Write view files and, where a robot is given, a data set; all of it or nothing.

    A scene of the data set is a picture, with the joint states that were nearer to it than to other pictures
    as free configurations. Nothing says which configurations collide.

    Args:
        source: an ``.mcap`` or ``.db3`` file, or a folder of them.
        folder: must not exist.
        world: of the robot, whose joints are named as in the recording; None reads no joint states.
        options: of the import.
    """
    if folder.exists():
        raise StorageError("the folder exists", expected="a new folder", got=str(folder))
    settings = options or RecordingOptions()
    digest = None
    with replacing(folder, "the import") as beside:
        (beside / "views").mkdir(parents=True)
        with opened(source) as reader:
            selection = _Selection(reader, source.name, settings, world)
            views = selection.views(beside / "views")
        if not views:
            raise DatasetError(
                f"{source} holds no complete picture",
                expected="depth images with a joint state and transforms of nearly the same stamp",
                got="; ".join(f"{count} times {reason}" for reason, count in selection.skipped.items())
                or "no picture",
                remedy="look at --base, --tolerance and the topics",
            )
        found = [] if world is None else _diagnosed(world, sorted((beside / "views").iterdir()))
        if world is not None:
            written = write_dataset(
                beside / "data",
                # Nobody says where the scenes come from.
                world=replace(world, scenes=None),
                images=np.stack([view.image for view in views if view.image is not None]),
                free=selection.free(views, world.space),
                generator={"recording": source.name, "stamps_ns": [view.stamp_ns for view in views]},
            )
            digest = written.digest
    wrong = sum(any(one.code in _WRONG for one in findings) for findings in found)
    flat = tuple(chain.from_iterable(found))
    return Imported(folder, len(views), selection.skipped, len(found), flat, wrong, digest)


def _diagnosed(world: SpatialWorld, files: Sequence[Path]) -> list[tuple[Finding, ...]]:
    """What is found in some of the views."""
    chosen = np.unique(np.linspace(0, len(files) - 1, _DIAGNOSED).round().astype(int))
    return [world.diagnosed(world.view(files[number].read_bytes())).findings for number in chosen]


@contextmanager
def opened(source: Path) -> Iterator[AnyReader]:
    """The messages of a ``.mcap`` or ``.db3`` file, or of those in a folder."""
    files = [source]
    if source.is_dir():
        files = sorted(one for one in source.iterdir() if one.suffix in KINDS)
    inside = source.resolve()
    # The reader of .db3 takes a path for a part of a URI, in which some characters lead elsewhere.
    if not files or any(
        one.suffix not in KINDS
        or not one.is_file()
        or not one.resolve().is_relative_to(inside)
        or any(mark in str(one) for mark in "?#%")
        for one in files
    ):
        raise DatasetError(
            f"{source} is no recording",
            expected=f"a file {' or '.join(KINDS)}, or a folder of them without links to elsewhere; "
            "no ?, # or % in its path",
            got=", ".join(one.name for one in files)[:200] or "none",
            remedy="convert other recordings, and compressed ones, by rosbags-convert or ros2 bag convert",
        )
    try:
        with AnyReader(files, default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except (CspaceError, MemoryError, OSError):
        raise
    except Exception as error:  # there is no list of what readers raise for bytes from outside
        raise DatasetError(
            f"{source.name} cannot be read",
            expected="a complete recording of ROS 2",
            got=f"{type(error).__name__}: {error}"[:200],
        ) from error


class _Selection:
    """The pictures that are taken out of a recording, and why others are not."""

    def __init__(
        self, reader: AnyReader, name: str, options: RecordingOptions, world: SpatialWorld | None
    ) -> None:
        self._reader, self._name, self._options, self._world = reader, name, options, world
        self.skipped: Counter[str] = Counter()
        self._within_ns = 1e9 * options.tolerance_s
        self._tree = TransformTree(options.base)
        # Those that differ from the one before.
        self._infos: list[tuple[int, dict[str, Any]]] = []
        self._names = [] if world is None else [options.joint_prefix + one for one in world.space.names]
        self._joints: dict[str, float] = {}
        self._since = 0
        self._states = Series(len(self._names))

    def views(self, folder: Path) -> list[RecordedView]:
        """The complete pictures, as far apart and as many as asked for; their view files go to a folder."""
        depth = self._depth_topic()
        self._read_small(depth)
        found: list[RecordedView] = []
        count = self._reader.topics[depth].msgcount
        with Progress("pictures", count, _LOG.info, "picture") as progress:
            for _, message in self._messages(depth):
                progress.advance()
                stamp = stamp_of(message.header)
                if found and stamp - found[-1].stamp_ns < 1e9 * self._options.every_s:
                    continue
                view = self._view(message, stamp, folder / f"{len(found):04d}-{stamp}.view")
                if isinstance(view, str):
                    self.skipped[view] += 1
                    continue
                found.append(view)
                if len(found) == self._options.most:
                    break
        return found

    def free(self, views: Sequence[RecordedView], space: JointSpace) -> list[NDArray[np.float64]]:
        """For each view the joint states (n, d) rad that were nearest to it, each once."""
        stamps, rows = self._states.sorted
        pictures = np.array([view.stamp_ns for view in views], dtype=np.int64)
        nearest = np.searchsorted((pictures[1:] + pictures[:-1]) // 2, stamps)
        close = np.abs(stamps - pictures[nearest]) <= max(1e9 * self._options.every_s, self._within_ns)
        usable = close & space.contains(rows)
        found = []
        for number, view in enumerate(views):
            passed = rows[usable & (nearest == number)]
            found.append(np.unique(np.concatenate([[view.state], passed]).round(6), axis=0))
        return found

    def _messages(self, *topics: str) -> Iterator[tuple[str, Any]]:
        connections = [one for one in self._reader.connections if one.topic in topics]
        for connection, _, data in self._reader.messages(connections):
            yield connection.topic, self._reader.deserialize(data, connection.msgtype)

    def _of_type(self, *types: str) -> list[str]:
        return sorted(topic for topic, info in self._reader.topics.items() if info.msgtype in types)

    def _depth_topic(self) -> str:
        topics = self._of_type(IMAGE, COMPRESSED)
        if self._options.depth is None:
            # Those of colour are of the same type.
            first = {topic: next(self._messages(topic), (topic, None))[1] for topic in topics}
            topics = [topic for topic, message in first.items() if message is not None and is_depth(message)]
        return self._chosen("depth images", "--depth", self._options.depth, topics)

    def _chosen(self, what: str, option: str, requested: str | None, topics: Sequence[str]) -> str:
        found = [topic for topic in topics if requested in (None, topic)]
        if len(found) != 1:
            raise DatasetError(
                f"{self._name} has no topic of {what} to choose"
                if not topics
                else f"{self._name} has several topics of {what}, or another",
                expected=f"one, or the one that {option} names",
                got=", ".join(topics)[:300] or f"topics {', '.join(sorted(self._reader.topics))}"[:300],
            )
        return found[0]

    def _read_small(self, depth: str) -> None:
        """All that is no picture."""
        infos = self._of_type(CAMERA_INFO)
        beside = [depth.rsplit("/", levels)[0] + "/camera_info" for levels in (1, 2)]
        near = [topic for topic in beside if topic in infos][:1] if self._options.camera_info is None else []
        info = self._chosen("camera infos", "--camera-info", self._options.camera_info, near or infos)
        topics = [info, *self._of_type(TRANSFORMS)]
        joints = None
        if self._world is not None:
            known = self._of_type(JOINT_STATE)
            joints = self._chosen("joint states", "--joint-states", self._options.joint_states, known)
            topics.append(joints)
        others: set[str] = set()
        for topic, message in self._messages(*topics):
            if topic == info:
                values = camera_info(message, rectified="/image_rect" in depth)
                if not self._infos or self._infos[-1][1] != values:
                    self._infos.append((stamp_of(message.header), values))
            elif topic == joints:
                others |= self._add_state(message)
            else:
                for transform in message.transforms:
                    self._tree.add(transform, static=topic.rsplit("/", 1)[-1] == "tf_static")
        if self._world is not None and not len(self._states.sorted[0]):
            raise DatasetError(
                f"{self._name} has no joint state of the robot",
                expected=f"joints {', '.join(self._names)}",
                got=f"joints {', '.join(sorted(others))}"[:300],
                remedy="give what is in front of the robot's names by --joint-prefix, name the topic by "
                "--joint-states, or import the arm with the recording's joint names",
            )

    def _add_state(self, message: Any) -> set[str]:
        """Add a joint state once all joints have come, in one message or several; returns others' names."""
        stamp = stamp_of(message.header)
        if not self._joints or abs(stamp - self._since) > self._within_ns:
            self._joints, self._since = {}, stamp
        came = zip(message.name, message.position.tolist(), strict=False)
        self._joints |= {name: at for name, at in came if name in self._names and np.isfinite(at)}
        if len(self._joints) < len(self._names):
            return set(message.name)
        self._states.add(stamp, [self._joints[name] for name in self._names])
        self._joints = {}
        return set()

    def _view(self, message: Any, stamp: int, path: Path) -> RecordedView | str:
        """The view of a picture, whose file is written, or why there is none."""
        pose = self._tree.pose(message.header.frame_id, stamp, self._within_ns)
        if pose is None:
            return f"no moving transform within {self._options.tolerance_s:g} s"
        state = None
        if self._world is not None:
            row = self._states.nearest(stamp, self._within_ns)
            if row is None:
                return f"no joint state within {self._options.tolerance_s:g} s"
            state = tuple(row.tolist())
        if not self._infos:
            return "no camera info"
        before = [info for since, info in self._infos if since <= stamp]
        camera_values = {"camera_info": before[-1] if before else self._infos[0][1], "pose": pose.tolist()}
        try:
            picture = depth_mm(message)
            if not in_range(picture).any():
                return "no reading"
            read_pinhole(camera_values, picture.shape)
            file = pack_view([encode_depth(picture)], [camera_values], None if state is None else list(state))
            image = None
            if self._world is not None and state is not None:
                image = np.asarray(self._world.examine_picture(file).images[0])
        except (ImageError, ScenarioError) as error:
            return str(error)[:300]
        path.write_bytes(file)
        return RecordedView(stamp, state, image)


class Series:
    """Rows of numbers by stamp."""

    def __init__(self, width: int) -> None:
        self._stamps, self._rows, self._width = array("q"), array("d"), width

    def add(self, stamp_ns: int, row: Iterable[float]) -> None:
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
        if not len(stamps):
            return None
        nearest = int(np.argmin(np.abs(stamps - stamp_ns)))
        return rows[nearest] if abs(int(stamps[nearest]) - stamp_ns) <= within_ns else None


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
        row = np.array((place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
        norm = np.linalg.norm(row[3:])
        if edge.parent != parent or not (
            abs(norm - 1.0) <= _QUATERNION_TOLERANCE and np.abs(row).max() < _FAR_M
        ):
            edge.wrong = f"parents {edge.parent!r} and {parent!r}, a norm of {norm:.3g}, {row}"
        elif static:
            edge.fixed = row
        else:
            edge.moving.add(stamp_of(transform.header), row)

    def pose(self, frame: str, stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
        """A frame in the base's, (4, 4); None where a moving transform has no such stamp."""
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
    """The depths (H, W) of a message, mm."""
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


def camera_info(info: Any, *, rectified: bool) -> dict[str, Any]:
    """The parts of a CameraInfo that say how its pictures are read, as plain values.

    K and D are of the raw picture, P of the one that image_proc has rectified.
    """
    is_projected = rectified and info.p[0] > 0.0
    return {
        "width": int(info.width),
        "height": int(info.height),
        "distortion_model": info.distortion_model,
        "d": [] if is_projected else info.d.tolist(),
        "k": info.p.reshape(3, 4)[:, :3].ravel().tolist() if is_projected else info.k.tolist(),
        "binning_x": int(info.binning_x),
        "binning_y": int(info.binning_y),
        "roi": {"x_offset": int(info.roi.x_offset), "y_offset": int(info.roi.y_offset)},
    }


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of an import, and what it runs."""
    parser.add_argument(
        "source", type=Path, help="a recording of ROS 2: FILE.mcap, FILE.db3, or their folder"
    )
    parser.add_argument("folder", type=Path, help="where views and data set go")
    add_options(parser, sensor=False)
    for name, one in RecordingOptions.model_fields.items():
        kind = finite if isinstance(one.default, float) else int if isinstance(one.default, int) else str
        flag = f"--{name.removesuffix('_s').replace('_', '-')}"
        text = f"{one.description}; default {one.default}" if one.default else one.description
        parser.add_argument(flag, dest=name, type=kind, default=one.default, metavar="VALUE", help=text)
    parser.set_defaults(run=_run, is_foreign=True)


def _run(options: argparse.Namespace) -> Imported:
    values = {name: getattr(options, name) for name in RecordingOptions.model_fields}
    try:
        settings = RecordingOptions.model_validate(values)
    except ValidationError as error:
        raise refused(error, ConfigError, "the import's options") from error
    return import_recording(options.source, options.folder, world=described(options), options=settings)
