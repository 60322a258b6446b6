"""The planar world as a value: an arm, the camera above it, and scenes of discs."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ConfigError, DatasetError, ImageError, ScenarioError
from cspace.files import read_object, validated
from cspace.view_file import View, check_counts
from cspace.world import Arrays, CheckCancelled, Contact, Examined, LinkSamplePoints, World
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, JointLimits, PlanarArm, link_sample_points
from cspace.worlds.planar.camera import Camera, Length, Place, decode_png
from cspace.worlds.planar.scenes import MAX_GIVEN, DiscScenes, GivenScenes, KnownDiscs, Scenes


@dataclass(frozen=True, slots=True)
class PlanarWorld(World):
    """An arm in a plane whose pictures show all of it; ``discs`` are (S, D, 3) x, y, radius in m."""

    kind: ClassVar[str] = "planar"
    scene_files: ClassVar[tuple[str, ...]] = ("discs",)

    body: PlanarArm = TWO_LINK
    sensor: Camera = field(default_factory=Camera)
    scenes: Scenes | None = field(default_factory=DiscScenes)

    def examine_picture(self, data: bytes | View, check_cancelled: CheckCancelled | None = None) -> Examined:
        """The picture, into which known discs are drawn; nothing is said of it."""
        view = View.of(data)
        if view.cameras or view.state is not None or view.depth_scale_m is not None:
            raise ImageError("the picture comes with a camera", remedy="leave camera and state out")
        if len(view.pictures) > 1:
            check_counts(len(view.pictures), 0)
        image = decode_png(view.pictures[0], self.sensor.pixels, check_cancelled)
        if view.known is None:
            return Examined(image[None])
        known = KnownDiscs.read(view.known, self.body, image)
        return Examined(known.drawn(self.sensor, check_cancelled or (lambda: None))[None], known=known)

    def contact(self, configuration: NDArray[np.floating], image: object, known: object) -> Contact | None:
        """With known discs alone: all else is seen."""
        del image
        return known.contact(configuration) if isinstance(known, KnownDiscs) else None

    def link_sample_points(self, points_per_link: int, side_m: float) -> LinkSamplePoints:
        return link_sample_points(self.body, self.sensor, points_per_link, side_m)

    def check_scenes(self, arrays: Arrays, count: int) -> None:
        discs = arrays.get("discs")
        if discs is None:
            return
        if discs.dtype != np.float64 or discs.ndim != 3 or (len(discs), discs.shape[2]) != (count, 3):
            raise DatasetError(
                "discs.npy does not fit",
                expected=f"float64 ({count}, any, 3)",
                got=f"{discs.dtype} {discs.shape}",
            )
        right = np.isfinite(discs).all(axis=-1) & (discs[..., 2] > 0.0)
        if not right.all():
            raise DatasetError("discs.npy holds a radius that is none", got=str(discs[~right][0]))

    def held_out(self, arrays: Arrays) -> GivenScenes | None:
        if "discs" not in arrays:
            return None
        rows = tuple(tuple(tuple(disc) for disc in scene) for scene in arrays["discs"].tolist())
        return GivenScenes((), rows[:MAX_GIVEN])

    def to_dict(self) -> dict[str, Any]:
        values: dict[str, Any] = {"kind": self.kind}
        values |= {"robot": self.body.to_dict(), "camera": self.sensor.to_dict()}
        if self.scenes != DiscScenes():
            values["scenes"] = None if self.scenes is None else self.scenes.to_dict()
        return values


# The types of its parts.
PARTS = {"body": (PlanarArm,), "sensor": (Camera,), "scenes": (DiscScenes, GivenScenes)}


def usual(arm: PlanarArm) -> PlanarWorld:
    """An arm that is seen and stands in scenes as most are."""
    return PlanarWorld(arm)


# By the names of their robots, the first where none is named.
EXAMPLES = {"two-link": PlanarWorld(TWO_LINK), "three-link": PlanarWorld(THREE_LINK)}


def read(values: Mapping[str, Any]) -> PlanarWorld:
    """The inverse of :meth:`PlanarWorld.to_dict`."""
    members = {"scenes": DiscScenes().to_dict(), **values}
    parts = read_object(_Parts, members, "the world", ScenarioError)
    given = parts.scenes
    kind: type[Scenes] = GivenScenes if isinstance(given, dict) and "train" in given else DiscScenes
    scenes = None if given is None else read_object(kind, given, "the scenes", ScenarioError)
    return PlanarWorld(PlanarArm.from_dict(parts.robot), parts.camera, scenes)


@validated(ScenarioError)
class _Parts:
    robot: Any
    camera: Camera
    scenes: Any


@validated(ScenarioError)
class Disc:
    """A round obstacle, in m."""

    x_m: Place
    y_m: Place
    radius_m: Length = 1.0
    shape: Literal["disc"] = "disc"


@dataclass(frozen=True, slots=True)
class Scenario:
    """A robot among discs, seen by a camera."""

    robot: PlanarArm
    discs: tuple[Disc, ...]
    camera: Camera = field(default_factory=Camera)

    @property
    def world(self) -> PlanarWorld:
        return PlanarWorld(self.robot, self.camera)

    @property
    def disc_array(self) -> NDArray[np.float64]:
        """(D, 3): x, y, radius in m."""
        return np.array([(d.x_m, d.y_m, d.radius_m) for d in self.discs], dtype=np.float64).reshape(-1, 3)

    @classmethod
    def from_array(cls, robot: PlanarArm, discs: NDArray[Any], camera: Camera | None = None) -> "Scenario":
        """A scenario from (D, 3) discs: x, y, radius in m."""
        return cls(robot, tuple(Disc(float(x), float(y), float(r)) for x, y, r in discs), camera or Camera())

    def to_dict(self) -> dict[str, Any]:
        return {
            "robot": self.robot.to_dict(),
            "discs": self.disc_array.tolist(),
            "camera": self.camera.to_dict(),
        }


def add_options(parser: argparse.ArgumentParser, *, sensor: bool) -> None:
    """See :func:`cspace.worlds.add_world_options`."""
    arm, camera = PlanarArm(), Camera()
    parser.set_defaults(pixels=camera.pixels, view=camera.extent_m)
    if sensor:
        parser.add_argument("--pixels", type=int, help="side of the data set's pictures")
        parser.add_argument("--view", type=float, nargs=4, metavar=("XMIN", "XMAX", "YMIN", "YMAX"))
    parser.add_argument(
        "--links", type=float, nargs="+", metavar="M", default=arm.link_lengths_m, help="link lengths, m"
    )
    parser.add_argument(
        "--half-width", type=float, metavar="M", default=arm.half_width_m, help="half the links' width, m"
    )
    parser.add_argument(
        "--limit",
        nargs=3,
        action="append",
        type=float,
        metavar=("JOINT", "LOW", "HIGH"),
        help="limits of one joint (1 is the first), rad; repeatable; other joints are circles",
    )


def described(options: argparse.Namespace) -> PlanarWorld:
    """The planar world of parsed options."""
    x_min_m, x_max_m, y_min_m, y_max_m = options.view
    if options.pixels < 1 or not (x_min_m < x_max_m and y_min_m < y_max_m):
        raise ConfigError("the camera does not fit", got=f"{options.pixels} pixels, {options.view}")
    arm = PlanarArm(tuple(options.links), options.half_width, _limits(options.limit, len(options.links)))
    return PlanarWorld(arm, Camera(x_min_m, x_max_m, y_min_m, y_max_m, options.pixels))


def _limits(entries: Sequence[tuple[float, float, float]] | None, dim: int) -> JointLimits | None:
    if not entries:
        return None
    limits: list[tuple[float, float] | None] = [None] * dim
    for joint, low, high in entries:
        if joint not in range(1, dim + 1):
            raise ConfigError(
                "the joint limits do not fit", expected=f"joints 1 to {dim}", got=f"joint {joint:g}"
            )
        limits[int(joint) - 1] = (low, high)
    return tuple(limits)
