"""The discs of a scene: drawn from a family, given by somebody, or known beside a picture."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import InputError, ScenarioError
from cspace.files import Record, read_json, read_object, validated
from cspace.simulator import Split
from cspace.world import CheckCancelled, Contact
from cspace.worlds.planar.arm import PlanarArm, link_offsets_m
from cspace.worlds.planar.camera import Camera, Length, Place

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
        """Which of (N, d) rad touch no disc: those that :mod:`cspace.worlds.planar.checks` finds free."""
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
        """Between links and discs, m."""
        return np.asarray(np.linalg.norm(offsets, axis=-1) - radii - self.arm.half_width_m)
