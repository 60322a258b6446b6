"""Where the discs of a scene come from: a family that is drawn, or scenes that somebody gave."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.simulator import Split
from cspace.strict_json import Record, validated
from cspace.worlds.planar.camera import Length

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
                expected=f"1 to {MAX_DISCS} discs, radii and a range above 0, and room for the largest disc "
                "off the base",
                got=str(self),
            )

    @property
    def words(self) -> str:
        """For readers."""
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
        """For readers."""
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
