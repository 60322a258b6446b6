"""The planar world as a value: an arm, the camera above it, and discs, drawn, given or known."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import DatasetError, ImageError, InputError, ScenarioError
from cspace.files import Record, read_json, read_object, validated
from cspace.simulator import Split
from cspace.view_file import View, check_counts
from cspace.world import Arrays, CheckCancelled, Contact, Examined, LinkSamplePoints, World
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm, link_offsets_m
from cspace.worlds.planar.camera import Camera, Length, Place, decode_png

MAX_DISCS, MAX_GIVEN = 64, 1000
_MAX_DRAWS = 10_000

_Count = Annotated[int, Field(ge=1, le=MAX_DISCS)]
Rows = Annotated[
    tuple[tuple[float, float, Annotated[float, Field(gt=0.0)]], ...],
    Field(min_length=1, max_length=MAX_DISCS),
]


@validated(ScenarioError)
class DiscScenes(Record):
    """A family of scenes: so many discs, uniform in radius and place."""

    count: tuple[_Count, _Count] = (3, 3)  # fewest and most discs, 1 to 64
    radius_m: tuple[Length, Length] = (1.0, 1.0)
    range_m: Length = 4.0
    base_clearance_m: Annotated[float, Field(ge=0.0)] = 0.3

    def __post_init__(self) -> None:
        fits = (
            self.count[0] <= self.count[1]
            and self.radius_m[0] <= self.radius_m[1]
            and self.base_clearance_m < 1.4 * self.range_m - self.radius_m[1]
        )
        if not fits:
            raise ScenarioError(
                "the family of scenes does not fit",
                expected="room for the largest disc off the base",
                got=str(self),
            )

    @property
    def words(self) -> str:
        counts, radii = (
            f"{low}" if low == high else f"{low} to {high}" for low, high in (self.count, self.radius_m)
        )
        return f"{counts} discs of radius {radii} m"

    def draw(self, rng: np.random.Generator, split: Split, index: int | None) -> NDArray[np.float64]:
        """(D, 3): x, y, radius in m; the split and the index are the generator's."""
        del split, index
        (fewest, most), (smallest, largest) = self.count, self.radius_m
        count = fewest if fewest == most else int(rng.integers(fewest, most, endpoint=True))
        discs: list[tuple[float, float, float]] = []
        for _ in range(_MAX_DRAWS):
            x_m, y_m = rng.uniform(-self.range_m, self.range_m, size=2)
            radius_m = smallest if smallest == largest else rng.uniform(smallest, largest)
            if np.hypot(x_m, y_m) >= radius_m + self.base_clearance_m:
                discs.append((x_m, y_m, radius_m))
            if len(discs) == count:
                return np.array(discs)
        raise ScenarioError("the family of scenes has no room for its discs", got=str(self))


@validated(ScenarioError)
class GivenScenes(Record):
    """Scenes that somebody gave: some to train with, others to evaluate by."""

    train: tuple[Rows, ...]  # for each scene its discs: x, y, radius in m
    held_out: tuple[Rows, ...]

    def __post_init__(self) -> None:
        if not 1 <= (count := len(self.train) + len(self.held_out)) <= MAX_GIVEN:
            raise ScenarioError("the given scenes do not fit", expected=f"1 to {MAX_GIVEN}", got=str(count))

    @classmethod
    def of(cls, scenes: tuple[Rows, ...]) -> "GivenScenes":
        """Every fifth scene is held out, and always the last one where there are fewer."""
        held_out = tuple(
            scene for place, scene in enumerate(scenes) if place % 5 == 4 or place + 1 == len(scenes) < 5
        )
        return cls(tuple(scene for scene in scenes if scene not in held_out), held_out)

    @property
    def words(self) -> str:
        return f"{len(self.held_out)} held-out scenes that were given"

    def part(self, split: Split) -> tuple[Rows, ...]:
        """The scenes of a split; both halves are all that is held out where that is one scene."""
        if split in (Split.VALIDATION, Split.TEST):
            found = self.held_out[split is Split.TEST :: 2] or self.held_out
        else:
            found = self.train
        if not found:
            raise ScenarioError(f"no scene was given for the split {split}", expected="one or more")
        return found

    def draw(self, rng: np.random.Generator, split: Split, index: int | None) -> NDArray[np.float64]:
        """(D, 3): the index-th of the split, from the first again behind the last; any of it without one."""
        scenes = self.part(split)
        place = int(rng.integers(len(scenes))) if index is None else index % len(scenes)
        return np.array(scenes[place], dtype=np.float64).reshape(-1, 3)


Scenes = DiscScenes | GivenScenes


_WHERE = "the planning scene"
# As the renderer draws discs, which is compiled; lines of a pixel that are looked at.
_RED, _LINES = (255.0, 0.0, 0.0), 8


@validated(InputError)
class _Disc:
    x_m: Place
    y_m: Place
    radius_m: Length


@validated(InputError)
class _Body:
    name: Annotated[str, Field(min_length=1, max_length=100)]
    disc: _Disc


@validated(InputError)
class _Scene:
    scene: Annotated[tuple[_Body, ...], Field(max_length=MAX_DISCS)]

    def __post_init__(self) -> None:
        names = [one.name for one in self.scene]
        if len(set(names)) < len(names):
            raise InputError("two discs of scene have one name", expected="a name each", got=str(names)[:200])


@dataclass(frozen=True, slots=True, eq=False)
class KnownDiscs:
    """See :class:`cspace.world.Known`."""

    arm: PlanarArm
    names: tuple[str, ...]
    discs: NDArray[np.float64]  # (D, 3) x, y, radius in m
    seen: NDArray[np.uint8]  # (P, P, 3), what the picture shows beside them

    @classmethod
    def read(cls, text: bytes, arm: PlanarArm, seen: NDArray[np.uint8]) -> "KnownDiscs":
        """Of JSON: ``scene`` lists ``name`` and ``disc``, which has ``x_m``, ``y_m`` and ``radius_m``."""
        bodies = read_object(_Scene, read_json(text, _WHERE, InputError), _WHERE, InputError).scene
        rows = [(one.disc.x_m, one.disc.y_m, one.disc.radius_m) for one in bodies]
        discs = np.asarray(rows, dtype=np.float64).reshape(-1, 3)
        return cls(arm, tuple(one.name for one in bodies), discs, seen)

    @property
    def size_bytes(self) -> int:
        return self.discs.nbytes + self.seen.nbytes + sum(map(len, self.names))

    def free(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """Which of (N, d) rad touch no disc: those that :mod:`cspace.worlds.planar.collision` finds free."""
        joints = self.arm.joint_positions_m(configurations)
        found = np.ones(len(joints), dtype=np.bool_)
        # One by one: all at once would take 100 MB.
        for disc in self.discs:
            found &= (self._gaps(link_offsets_m(joints, disc[None, :2]), disc[2]) > 0.0).all(axis=(1, 2))
            check_cancelled()
        return found

    def certain(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """None: other discs than the known ones are seen."""
        check_cancelled()
        return np.zeros(len(configurations), dtype=np.bool_)

    def contact(self, configuration: NDArray[np.floating]) -> Contact | None:
        """Where a configuration (d,) rad is deepest in a disc; None where it touches none."""
        offsets = link_offsets_m(self.arm.joint_positions_m(configuration), self.discs[:, :2])[0]
        gaps = self._gaps(offsets, self.discs[:, 2])
        link, disc = np.unravel_index(np.argmin(gaps), gaps.shape)
        if gaps[link, disc] > 0.0:
            return None
        x, y = (self.discs[disc, :2] - offsets[link, disc]).tolist()
        return Contact("known", f"link {link + 1}", self.names[disc], (x, y, 0.0), -float(gaps[link, disc]))

    def drawn(self, camera: Camera, check_cancelled: CheckCancelled = lambda: None) -> NDArray[np.uint8]:
        """The picture with the discs in it, uint8 (P, P, 3)."""
        left, right, bottom, top = camera.extent_m
        columns = np.linspace(left, right, camera.pixels + 1)
        lines = top - (np.arange(camera.pixels * _LINES) + 0.5) * (top - bottom) / (camera.pixels * _LINES)
        picture = self.seen.astype(np.float64)
        for x, y, radius in self.discs:
            chords = np.sqrt(np.maximum(radius**2 - (lines - y) ** 2, 0.0)).reshape(-1, _LINES, 1)
            covered = np.zeros((camera.pixels, camera.pixels))
            for half in np.moveaxis(chords, 1, 0):
                ends = np.maximum(columns[:-1], x - half), np.minimum(columns[1:], x + half)
                covered += np.maximum(ends[1] - ends[0], 0.0)
            share = covered[..., None] / (_LINES * (columns[1] - columns[0]))
            picture += share * (np.asarray(_RED) - picture)
            check_cancelled()
        return np.asarray(np.floor(picture + 0.5), dtype=np.uint8)

    def _gaps(
        self, offsets: NDArray[np.float64], radii: NDArray[np.float64] | np.float64
    ) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm(offsets, axis=-1) - radii - self.arm.half_width_m)


@dataclass(frozen=True, slots=True)
class PlanarWorld(World):
    """An arm in a plane whose pictures show all of it; ``discs`` are (S, D, 3) x, y, radius in m."""

    kind: ClassVar[str] = "planar"
    scene_files: ClassVar[tuple[str, ...]] = ("discs",)

    body: PlanarArm = TWO_LINK
    sensor: Camera = field(default_factory=Camera)
    scenes: Scenes | None = field(default_factory=DiscScenes)

    def examine_picture(self, data: bytes | View, check_cancelled: CheckCancelled = lambda: None) -> Examined:
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
        return Examined(known.drawn(self.sensor, check_cancelled)[None], known=known)

    def contact(self, configuration: NDArray[np.floating], image: object, known: object) -> Contact | None:
        del image
        return known.contact(configuration) if isinstance(known, KnownDiscs) else None

    def link_sample_points(self, points_per_link: int, side_m: float) -> LinkSamplePoints:
        camera = self.sensor
        sides = np.asarray([-side_m, 0.0, side_m] if side_m > 0.0 else [0.0], dtype=np.float32)
        lengths = np.asarray(self.body.link_lengths_m, dtype=np.float32)
        links = len(lengths)
        # What each link adds to each point along its own direction and across it, m.
        reaches = np.zeros((2, links, links, len(sides), points_per_link), dtype=np.float32)
        for link in range(links):
            reaches[0, :link, link] = lengths[:link, None, None]
            reaches[0, link, link] = lengths[link] * np.linspace(0.0, 1.0, points_per_link, dtype=np.float32)
            reaches[1, link, link] = sides[:, None]
        along, beside = reaches.reshape(2, links, -1)
        width = np.float32(camera.x_max_m - camera.x_min_m)
        height = np.float32(camera.y_max_m - camera.y_min_m)
        across = np.concatenate([along, -beside]) / width
        # Row 0 of a picture is its top.
        down = -np.concatenate([beside, along]) / height
        left = -camera.x_min_m / (camera.x_max_m - camera.x_min_m)
        top = camera.y_max_m / (camera.y_max_m - camera.y_min_m)
        origin = np.repeat(np.asarray([left, top], dtype=np.float32), along.shape[1])
        return LinkSamplePoints(np.concatenate([across, down], axis=1), origin)

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

    def to_dict(self) -> dict[str, Any]:
        values: dict[str, Any] = {"kind": self.kind}
        values |= {"robot": self.body.to_dict(), "camera": self.sensor.to_dict()}
        if self.scenes != DiscScenes():
            values["scenes"] = None if self.scenes is None else self.scenes.to_dict()
        return values


# The types of its parts.
PARTS = {"body": (PlanarArm,), "sensor": (Camera,), "scenes": (DiscScenes, GivenScenes)}


# An arm that is seen and stands in scenes as most are.
usual = PlanarWorld
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
        return np.array([(d.x_m, d.y_m, d.radius_m) for d in self.discs], dtype=np.float64).reshape(-1, 3)

    @classmethod
    def from_array(cls, robot: PlanarArm, discs: NDArray[Any], camera: Camera | None = None) -> "Scenario":
        return cls(robot, tuple(Disc(float(x), float(y), float(r)) for x, y, r in discs), camera or Camera())
