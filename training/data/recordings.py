"""Import of recordings of ROS 2: view files, a preview, and a data set of the robot's joint states."""

import argparse
import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cspace.dataset import write_dataset
from cspace.errors import ConfigError, DatasetError, ImageError, ScenarioError, StorageError
from cspace.files import replacing
from cspace.png import encode_png
from cspace.space import JointSpace
from cspace.view_file import pack_view
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, in_range
from cspace.worlds.spatial.camera_info import read_pinhole, undistorted
from cspace.worlds.spatial.world import SpatialWorld, add_options, described
from services.commands import finite
from services.progress import Progress
from training.data.bag import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    JOINT_STATE,
    TRANSFORMS,
    Bag,
    Series,
    TransformTree,
    camera_info,
    depth_mm,
    is_depth,
    opened,
    stamp_of,
)

_LOG = logging.getLogger(__name__)
MOST_PICTURES = 1000
_PREVIEWS, _PREVIEW_HEIGHT = 4, 360
# What is as near as the first is white in the preview, what is as far as the second is black.
_NEAR_MM, _FAR_MM = 200, 3000
_BLANK, _ROBOT = (40, 40, 90), (255, 140, 0)


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """How a recording is read.

    Args:
        base: tf frame of the robot's base.
        depth: topic of the depth images; None for the only one.
        camera_info: topic of their cameras; None for the one beside them, or the only one.
        joint_states: topic; None for the only one.
        every_s: least time between two pictures that are taken.
        tolerance_s: how far stamps of picture, joint state and moving transforms may be apart.
        most: pictures that are taken.
        time_limit_s: for the whole import.

    Raises:
        ConfigError: a number is out of its range.
    """

    base: str = "base_link"
    depth: str | None = None
    camera_info: str | None = None
    joint_states: str | None = None
    every_s: float = 1.0
    tolerance_s: float = 0.05
    most: int = 100
    time_limit_s: float = 600.0

    def __post_init__(self) -> None:
        fits = self.every_s >= 0.0 and self.tolerance_s >= 0.0 and self.time_limit_s > 0.0
        if not fits or not 1 <= self.most <= MOST_PICTURES:
            raise ConfigError(
                "the import's options do not fit",
                expected=f"times of 0 s or more, a time limit above 0, 1 to {MOST_PICTURES} pictures",
                got=f"{self.every_s:g}, {self.tolerance_s:g}, {self.time_limit_s:g} s, {self.most} pictures",
            )


@dataclass(frozen=True, slots=True, eq=False)
class TakenView:
    """One picture of a recording that is complete.

    Args:
        stamp_ns: of the picture.
        tile: (360, any, 3) uint8, how a preview shows it.
        state: (d,) rad; None where no robot is known.
        image: the picture as the robot's world reads it; None where no robot is known.
    """

    stamp_ns: int
    tile: NDArray[np.uint8]
    state: tuple[float, ...] | None
    image: NDArray[np.uint8] | None


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """What an import wrote.

    Args:
        folder: holds ``views``, ``preview.png`` and, where a robot is known, ``data``.
        views: how many.
        skipped: why pictures were left out, and how many for each reason.
        warnings: codes of what the robot's world says of the views, and of how many it says it.
        digest: of the data set; None where no robot is known.
    """

    folder: Path
    views: int
    skipped: Mapping[str, int]
    warnings: Mapping[str, int]
    digest: str | None

    def __str__(self) -> str:
        lines = [f"{self.folder}", f"  views           {self.views}"]
        lines += [f"  skipped         {count}: {reason}" for reason, count in sorted(self.skipped.items())]
        lines += [f"  warned          {count}: {code}" for code, count in sorted(self.warnings.items())]
        return "\n".join(lines + ([f"  digest          {self.digest}"] if self.digest else []))


def import_recording(
    source: Path, folder: Path, *, world: SpatialWorld | None = None, options: RecordingOptions | None = None
) -> Imported:
    """Write view files, a preview and, where a robot is given, a data set; all of it or nothing.

    A scene of the data set is a picture, with the joint states that were nearer to it than to other pictures
    as free configurations. Nothing says which configurations collide.

    Args:
        source: an ``.mcap`` or ``.db3`` file, or a folder of them.
        folder: must not exist.
        world: of the robot, whose joints are named as in the recording; None reads no joint states.
        options: of the import.

    Raises:
        DatasetError: the recording cannot be read, lacks a topic or a transform, holds no complete picture,
            or is no file of its kind.
        StorageError: the folder exists or cannot be written.
    """
    if folder.exists():
        raise StorageError("the folder exists", expected="a new folder", got=str(folder))
    settings = options or RecordingOptions()
    digest = None
    with replacing(folder, "the import") as beside:
        (beside / "views").mkdir(parents=True)
        with opened(source) as bag:
            taking = _Taking(bag, settings, world)
            views = taking.views(beside / "views")
        if not views:
            raise DatasetError(
                f"{source} holds no complete picture",
                expected="depth images with a joint state and transforms of nearly the same stamp",
                got="; ".join(f"{count} times {reason}" for reason, count in taking.skipped.items())
                or "no picture",
                remedy="look at --base, --tolerance and the topics",
            )
        (beside / "preview.png").write_bytes(preview(views))
        if world is not None:
            written = write_dataset(
                beside / "data",
                # Nobody says where the scenes come from.
                world=replace(world, scenes=None),
                images=np.stack([view.image for view in views if view.image is not None]),
                free=taking.free(views, world.space),
                generator={"recording": source.name, "stamps_ns": [view.stamp_ns for view in views]},
            )
            digest = written.digest
    return Imported(folder, len(views), taking.skipped, taking.warnings, digest)


class _Taking:
    """The pictures that are taken out of a recording, with what :class:`Imported` tells of the others."""

    def __init__(self, bag: Bag, options: RecordingOptions, world: SpatialWorld | None) -> None:
        self._bag, self._options, self._world = bag, options, world
        self.skipped: Counter[str] = Counter()
        self.warnings: Counter[str] = Counter()
        self._within_ns = 1e9 * options.tolerance_s
        self._tree = TransformTree(options.base)
        # Those that differ from the one before.
        self._infos: list[tuple[int, dict[str, Any]]] = []
        self._names = () if world is None else world.space.names
        self._states = Series(len(self._names))

    def views(self, folder: Path) -> list[TakenView]:
        """All complete pictures, so far apart and so many as is asked for; their view files go to a folder.

        Raises:
            DatasetError: as :func:`import_recording`.
        """
        depth = self._depth_topic()
        self._read_small(depth)
        taken: list[TakenView] = []
        with Progress("pictures", self._bag.count(depth), _LOG.info, "picture") as progress:
            for _, message in self._bag.messages(depth):
                progress.advance()
                stamp = stamp_of(message.header)
                if taken and stamp - taken[-1].stamp_ns < 1e9 * self._options.every_s:
                    continue
                view = self._view(message, stamp, folder / f"{len(taken):04d}-{stamp}.view")
                if isinstance(view, str):
                    self.skipped[view] += 1
                    continue
                taken.append(view)
                if len(taken) == self._options.most:
                    break
        return taken

    def free(self, views: Sequence[TakenView], space: JointSpace) -> list[NDArray[np.float64]]:
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

    def _depth_topic(self) -> str:
        topics = self._bag.of_type(IMAGE, COMPRESSED)
        if self._options.depth is None:
            # Those of colour are of the same type.
            first = {topic: next(self._bag.messages(topic), (topic, None))[1] for topic in topics}
            topics = [topic for topic, message in first.items() if message is not None and is_depth(message)]
        return self._chosen("depth images", "--depth", self._options.depth, topics)

    def _chosen(self, what: str, option: str, requested: str | None, topics: Sequence[str]) -> str:
        found = [topic for topic in topics if requested in (None, topic)]
        if len(found) != 1:
            raise DatasetError(
                f"{self._bag.name} has no topic of {what} to choose"
                if not topics
                else f"{self._bag.name} has several topics of {what}, or another",
                expected=f"one, or the one that {option} names",
                got=", ".join(topics)[:300] or f"topics {', '.join(sorted(self._bag.topics))}"[:300],
            )
        return found[0]

    def _read_small(self, depth: str) -> None:
        """All that is no picture."""
        infos = self._bag.of_type(CAMERA_INFO)
        beside = [depth.rsplit("/", levels)[0] + "/camera_info" for levels in (1, 2)]
        near = [topic for topic in beside if topic in infos][:1] if self._options.camera_info is None else []
        info = self._chosen("camera infos", "--camera-info", self._options.camera_info, near or infos)
        topics = [info, *self._bag.of_type(TRANSFORMS)]
        joints = None
        if self._world is not None:
            known = self._bag.of_type(JOINT_STATE)
            joints = self._chosen("joint states", "--joint-states", self._options.joint_states, known)
            topics.append(joints)
        others: set[str] = set()
        for topic, message in self._bag.messages(*topics):
            if topic == info:
                values = camera_info(message)
                if not self._infos or self._infos[-1][1] != values:
                    self._infos.append((stamp_of(message.header), values))
            elif topic == joints:
                others |= self._add_state(message)
            else:
                for transform in message.transforms:
                    self._tree.add(transform, static=topic.rsplit("/", 1)[-1] == "tf_static")
        if self._world is not None and not len(self._states.sorted[0]):
            raise DatasetError(
                f"{self._bag.name} has no joint state of the robot",
                expected=f"joints {', '.join(self._names)}",
                got=f"joints {', '.join(sorted(others))}"[:300],
                remedy="import the arm with the recording's joint names, or name its topic by --joint-states",
            )

    def _add_state(self, message: Any) -> set[str]:
        """Take a joint state of the whole robot; returns its names where it is of others."""
        at = dict(zip(message.name, message.position.tolist(), strict=False))
        row = [at.get(name, np.nan) for name in self._names]
        if not np.isfinite(row).all():
            return set(message.name)
        self._states.add(stamp_of(message.header), row)
        return set()

    def _view(self, message: Any, stamp: int, path: Path) -> TakenView | str:
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
            camera, distortion = read_pinhole(camera_values, picture.shape)
            file = pack_view([encode_depth(picture)], [camera_values], None if state is None else list(state))
            image = None
            if self._world is not None:
                examined = self._world.examine_picture(file)
                image = np.asarray(examined.images[0])
                self.warnings.update({one.code for one in examined.findings})
            spheres = None if self._world is None or state is None else self._world.body.spheres_at(state)
            tile = _tile(undistorted(picture, camera, distortion), camera, spheres)
            path.write_bytes(file)
            return TakenView(stamp, tile, state, image)
        except (ImageError, ScenarioError) as error:
            return str(error)[:300]


def preview(views: Sequence[TakenView]) -> bytes:
    """Some of the pictures side by side as a PNG: near things bright, the robot's spheres as circles."""
    chosen = np.unique(np.linspace(0, len(views) - 1, _PREVIEWS).round().astype(int))
    return encode_png(np.concatenate([views[number].tile for number in chosen], axis=1))


def _tile(
    picture: NDArray[np.uint16], camera: DepthCamera, spheres: NDArray[np.float64] | None
) -> NDArray[np.uint8]:
    depth = np.clip(picture, _NEAR_MM, _FAR_MM).astype(np.float64)
    grey = np.rint(255.0 * (_FAR_MM - depth) / (_FAR_MM - _NEAR_MM)).astype(np.uint8)
    shown = Image.fromarray(
        np.where(in_range(picture)[..., None], grey[..., None], np.array(_BLANK, np.uint8))
    )
    scale = _PREVIEW_HEIGHT / camera.height
    shown = shown.resize((max(1, round(camera.width * scale)), _PREVIEW_HEIGHT), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(shown)
    for x, y, z, radius in () if spheres is None else spheres:
        column, row, away = camera.project((x, y, z))
        # Others are behind the camera, or about it.
        if away > radius:
            middle, size = scale * np.array((column, row)), scale * radius * camera.fx / away
            draw.ellipse((*(middle - size), *(middle + size)), outline=_ROBOT)
    return np.asarray(shown)


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of an import, and what it runs."""
    usual = RecordingOptions()
    parser.add_argument(
        "source", type=Path, help="a recording of ROS 2: FILE.mcap, FILE.db3, or their folder"
    )
    parser.add_argument("folder", type=Path, help="where views, preview and data set go")
    add_options(parser, sensor=False)
    parser.add_argument(
        "--base", default=usual.base, help="tf frame of the robot's base; default %(default)s"
    )
    for name, words in (
        ("depth", "depth images; default the only one"),
        ("camera-info", "their cameras; default the one beside them"),
        ("joint-states", "joint states; default the only one"),
    ):
        parser.add_argument(f"--{name}", metavar="TOPIC", help=f"topic of the {words}")
    for name, words in (
        ("every", "least time between pictures that are taken"),
        ("tolerance", "how far the stamps of a picture, a joint state and a transform may differ"),
        ("time-limit", "for the import"),
    ):
        key = f"{name.replace('-', '_')}_s"
        default = getattr(usual, key)
        told = f"{words}; default {default:g} s"
        parser.add_argument(f"--{name}", dest=key, type=finite, default=default, metavar="S", help=told)
    parser.add_argument("--most", type=int, default=usual.most, help="pictures; default %(default)s")
    parser.set_defaults(run=_run, is_foreign=True)


def _run(options: argparse.Namespace) -> Imported:
    settings = RecordingOptions(**{one.name: getattr(options, one.name) for one in fields(RecordingOptions)})
    return import_recording(options.source, options.folder, world=described(options), options=settings)
