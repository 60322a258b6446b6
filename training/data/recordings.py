"""Import of recordings of ROS 2, without ROS: view files, and a data set of the joint states.

All stamps are those of the messages' headers. A recording is read in a worker that the kernel bounds
(:mod:`cspace.bounded_worker`), so nothing here counts what it holds.
"""

import argparse
import logging
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from cspace.dataset import write_dataset
from cspace.errors import ConfigError, CspaceError, DatasetError, ImageError, ScenarioError, StorageError
from cspace.files import project_error, replacing
from cspace.space import JointSpace
from cspace.view_file import pack_view
from cspace.world import Finding
from cspace.worlds.spatial.camera import decode_depth, encode_depth, in_range, read_pinhole, to_mm
from cspace.worlds.spatial.diagnosis import ELSEWHERE
from cspace.worlds.spatial.hypotheses import HYPOTHESES
from cspace.worlds.spatial.poses import quaternion_pose
from cspace.worlds.spatial.world import SpatialWorld, named
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
    """A complete picture; ``state`` (d,) rad and the world's ``image`` are None without a robot."""

    stamp_ns: int
    state: tuple[float, ...] | None
    image: NDArray[np.uint8] | None


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """What an import wrote into a folder: views and, where a robot is known, a data set with a digest.

    ``skipped`` counts pictures that were left out by the reason; ``wrong`` of the ``diagnosed`` views show
    the arm in another place than their state and pose say.
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
    digest, skipped = None, Counter[str]()
    with replacing(folder, "the import") as beside:
        (beside / "views").mkdir(parents=True)
        with opened(source) as reader:
            recording = Recording.read(reader, settings, world)
            views = list(_views(reader, recording, settings, world, beside / "views", skipped))
        if not views:
            raise DatasetError(
                f"{source} holds no complete picture",
                expected="depth images with a joint state and transforms of nearly the same stamp",
                got="; ".join(f"{count} times {reason}" for reason, count in skipped.items()) or "no picture",
                remedy="look at --base, --tolerance and the topics",
            )
        found = [] if world is None else _diagnosed(world, sorted((beside / "views").iterdir()))
        if world is not None:
            written = write_dataset(
                beside / "data",
                # Nobody says where the scenes come from.
                world=replace(world, scenes=None),
                images=np.stack([view.image for view in views if view.image is not None]),
                free=_free(views, recording.states, world.space, settings),
                generator={"recording": source.name, "stamps_ns": [view.stamp_ns for view in views]},
            )
            digest = written.digest
    wrong = sum(any(one.code in _WRONG for one in findings) for findings in found)
    return Imported(folder, len(views), skipped, len(found), tuple(chain(*found)), wrong, digest)


def _diagnosed(world: SpatialWorld, files: Sequence[Path]) -> list[tuple[Finding, ...]]:
    """What is found in some of the views."""
    chosen = np.unique(np.linspace(0, len(files) - 1, _DIAGNOSED).round().astype(int))
    return [world.diagnosed(world.view(files[number].read_bytes())).findings for number in chosen]


@contextmanager
def opened(source: Path) -> Iterator[AnyReader]:
    """The messages of a ``.mcap`` or ``.db3`` file, or of those in a folder."""
    files = [one for one in sorted(source.iterdir()) if one.suffix in KINDS] if source.is_dir() else [source]
    if not files or not all(one.suffix in KINDS and one.is_file() for one in files):
        raise DatasetError(
            f"{source} is no recording",
            expected=f"a file {' or '.join(KINDS)}, or a folder of them",
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


def _messages(reader: AnyReader, *topics: str) -> Iterator[tuple[str, Any]]:
    connections = [one for one in reader.connections if one.topic in topics]
    for connection, _, data in reader.messages(connections):
        yield connection.topic, reader.deserialize(data, connection.msgtype)


def _topics(reader: AnyReader, *types: str) -> list[str]:
    return sorted(topic for topic, info in reader.topics.items() if info.msgtype in types)


def _chosen(what: str, option: str, requested: str | None, topics: Sequence[str]) -> str:
    found = [topic for topic in topics if requested in (None, topic)]
    if len(found) != 1:
        raise DatasetError(
            f"the recording has no topic, or several, of {what}",
            expected=f"one, or the one that {option} names",
            got=", ".join(topics)[:300] or "none",
        )
    return found[0]


def _table(stamps_ns: Sequence[int], rows: Sequence[NDArray[np.float64]], width: int) -> pd.DataFrame:
    """Rows of numbers by their stamps, in order."""
    return pd.DataFrame(np.reshape(rows, (-1, width)), pd.Index(stamps_ns, np.int64)).sort_index(
        kind="stable"
    )


def _nearest(table: pd.DataFrame, stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
    """The row of the nearest stamp; None where that is farther away."""
    (row,) = table.index.get_indexer([stamp_ns], method="nearest", tolerance=within_ns)
    return None if row < 0 else table.to_numpy()[row]


@dataclass(slots=True)
class Recording:
    """Topic of the pictures, cameras that differ from the one before, transforms and joint states."""

    depth: str
    transforms: "Transforms"
    infos: list[tuple[int, dict[str, Any]]]
    states: pd.DataFrame  # (n, d) rad

    @classmethod
    def read(cls, reader: AnyReader, options: RecordingOptions, world: SpatialWorld | None) -> "Recording":
        """Read it, joint states where the robot is known."""
        images = _topics(reader, IMAGE, COMPRESSED)
        if options.depth is None:
            # Those of colour are of the same type.
            first = {topic: next(_messages(reader, topic), (topic, None))[1] for topic in images}
            images = [topic for topic, message in first.items() if message and is_depth(message)]
        depth = _chosen("depth images", "--depth", options.depth, images)
        infos = _topics(reader, CAMERA_INFO)
        beside = [depth.rsplit("/", levels)[0] + "/camera_info" for levels in (1, 2)]
        near = [topic for topic in beside if topic in infos][:1] if options.camera_info is None else []
        info = _chosen("camera infos", "--camera-info", options.camera_info, near or infos)
        names = [] if world is None else [options.joint_prefix + one for one in world.space.names]
        joints = ""
        if world is not None:
            known = _topics(reader, JOINT_STATE)
            joints = _chosen("joint states", "--joint-states", options.joint_states, known)
        transforms, cameras, seen = Transforms(options.base), list[tuple[int, dict[str, Any]]](), set[str]()
        stamps, rows = list[int](), list[NDArray[np.float64]]()
        for topic, message in _messages(reader, info, joints, *_topics(reader, TRANSFORMS)):
            if topic == info:
                values = camera_info(message, rectified="/image_rect" in depth)
                if not cameras or cameras[-1][1] != values:
                    cameras.append((stamp_of(message.header), values))
            elif topic == joints:
                seen.update(message.name)
                angles = dict(zip(message.name, message.position.tolist(), strict=False))
                stamps.append(stamp_of(message.header))
                rows.append(np.array([angles.get(name, np.nan) for name in names]))
            else:
                for transform in message.transforms:
                    transforms.add(transform, static=topic.rsplit("/", 1)[-1] == "tf_static")
        states = pd.DataFrame()
        if world is not None:
            states = joined(_table(stamps, rows, len(names)), 1e9 * options.tolerance_s)
        if world is not None and states.empty:
            raise DatasetError(
                "the recording has no joint state of the robot",
                expected=f"joints {', '.join(names)}",
                got=f"joints {', '.join(sorted(seen))}"[:300],
                remedy="give what is in front of the robot's names by --joint-prefix, name the topic by "
                "--joint-states, or import the arm with the recording's joint names",
            )
        return cls(depth, transforms, cameras, states)

    def camera(self, stamp_ns: int) -> dict[str, Any]:
        """The camera at a time."""
        return next((info for since, info in reversed(self.infos) if since <= stamp_ns), self.infos[0][1])


def joined(parts: pd.DataFrame, within_ns: float) -> pd.DataFrame:
    """Whole joint states (n, d) of messages (m, d) that hold some joints each; NaN those that they do not."""
    parts = parts.where(np.isfinite(parts))
    stamps = parts.index.to_numpy()[:, None] - parts.index.min()
    since = pd.DataFrame(np.where(parts.notna(), stamps, np.nan)).ffill().to_numpy()
    whole = parts.notna().any(axis=1).to_numpy() & (stamps - since <= within_ns).all(axis=1)
    found = parts.ffill()[whole]
    return found[~found.index.duplicated(keep="last")]


def _views(
    reader: AnyReader,
    recording: Recording,
    options: RecordingOptions,
    world: SpatialWorld | None,
    folder: Path,
    skipped: Counter[str],
) -> Iterator[RecordedView]:
    """The complete pictures, as far apart and as many as asked for; their view files go to a folder."""
    count, next_ns, within_ns = 0, -np.inf, 1e9 * options.tolerance_s
    with Progress("pictures", reader.topics[recording.depth].msgcount, _LOG.info, "picture") as progress:
        for _, message in _messages(reader, recording.depth):
            progress.advance()
            stamp = stamp_of(message.header)
            if stamp < next_ns:
                continue
            pose = recording.transforms.pose(message.header.frame_id, stamp, within_ns)
            state = None if world is None else _nearest(recording.states, stamp, within_ns)
            if pose is None or (world is not None and state is None):
                what = "moving transform" if pose is None else "joint state"
                skipped[f"no {what} within {options.tolerance_s:g} s"] += 1
                continue
            if not recording.infos:
                skipped["no camera info"] += 1
                continue
            values = {"camera_info": recording.camera(stamp), "pose": pose.tolist()}
            try:
                picture = depth_mm(message)
                if not in_range(picture).any():
                    skipped["no reading"] += 1
                    continue
                read_pinhole(values, picture.shape)
                file = pack_view([encode_depth(picture)], [values], None if state is None else state.tolist())
                image = None if world is None else np.asarray(world.examine_picture(file).images[0])
            except (ImageError, ScenarioError) as error:
                skipped[str(error)[:300]] += 1
                continue
            (folder / f"{count:04d}-{stamp}.view").write_bytes(file)
            yield RecordedView(stamp, None if state is None else tuple(state.tolist()), image)
            count, next_ns = count + 1, stamp + max(1, round(1e9 * options.every_s))
            if count == options.most:
                return


def _free(
    views: Sequence[RecordedView], states: pd.DataFrame, space: JointSpace, options: RecordingOptions
) -> list[NDArray[np.float64]]:
    """For each view the joint states (n, d) rad that were nearest to it, each once."""
    within_ns = 1e9 * max(options.every_s, options.tolerance_s)
    pictures, rows = pd.Index([view.stamp_ns for view in views]), states.to_numpy()
    nearest = pictures.get_indexer(states.index, method="nearest", tolerance=within_ns)
    nearest = np.where(space.contains(rows), nearest, -1)
    return [
        np.unique(np.concatenate([[view.state], rows[nearest == number]]).round(6), axis=0)
        for number, view in enumerate(views)
    ]


class Transforms:
    """The tf tree; transforms that are none, as of zero quaternions, are left out."""

    def __init__(self, base: str) -> None:
        self._base = base.lstrip("/")
        self._parents: dict[str, str] = {}
        # By the child frame: x, y, z, m, and a quaternion, of moving ones by their stamps.
        self._static: dict[str, NDArray[np.float64]] = {}
        self._moving: dict[str, tuple[list[int], list[NDArray[np.float64]]]] = {}
        self._tables: dict[str, pd.DataFrame] = {}

    def add(self, transform: Any, *, static: bool) -> None:
        """One more transform."""
        child, parent = transform.child_frame_id.lstrip("/"), transform.header.frame_id.lstrip("/")
        place, turn = transform.transform.translation, transform.transform.rotation
        row = np.array((place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
        if not abs(np.linalg.norm(row[3:]) - 1.0) <= 1e-2:
            return
        if self._parents.setdefault(child, parent) != parent:
            raise DatasetError(
                f"the frame {child!r} has two parents"[:200],
                expected="a tree of frames",
                got=f"{self._parents[child]!r} and {parent!r}"[:200],
            )
        if static:
            self._static[child] = row
        else:
            stamps, rows = self._moving.setdefault(child, ([], []))
            stamps.append(stamp_of(transform.header))
            rows.append(row)

    def pose(self, frame: str, stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
        """A frame in the base's, (4, 4); None where a moving transform has no such stamp."""
        ours, bases = self._chain(frame.lstrip("/")), self._chain(self._base)
        shared = next((one for one in ours if one in bases), None)
        if shared is None:
            raise DatasetError(
                f"no transforms lead from {frame!r} to the base {self._base!r}"[:200],
                expected="both in one tf tree",
                got=f"frames {', '.join(sorted({*self._parents, *self._parents.values()}))}"[:300],
                remedy="name the robot's base by --base",
            )
        up = self._matrix(ours[: ours.index(shared)], stamp_ns, within_ns)
        down = self._matrix(bases[: bases.index(shared)], stamp_ns, within_ns)
        return None if up is None or down is None else np.linalg.inv(down) @ up

    def _chain(self, frame: str) -> list[str]:
        """A frame, its parent and so on, up to the root, or once around a loop."""
        found = [frame]
        while (parent := self._parents.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def _matrix(self, frames: Sequence[str], stamp_ns: int, within_ns: float) -> NDArray[np.float64] | None:
        """From the first frame's coordinates to those of the last one's parent."""
        found = np.eye(4)
        for frame in frames:
            row = self._static.get(frame)
            if row is None:
                if frame not in self._tables:
                    table = _table(*self._moving[frame], 7)
                    self._tables[frame] = table[~table.index.duplicated()]
                row = _nearest(self._tables[frame], stamp_ns, within_ns)
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
    return to_mm(depth) if kind == "f4" else depth.astype(np.uint16)


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
    parser.add_argument(
        "--arm", metavar="NAME|FILE", help="the arm: panda, or what python -m training.robots import wrote"
    )
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
        raise project_error(error, ConfigError, "the import's options") from error
    world = None if options.arm is None else named(options.arm)
    return import_recording(options.source, options.folder, world=world, options=settings)
