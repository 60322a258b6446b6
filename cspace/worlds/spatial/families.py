"""Families of scenes that arms meet: what stands where, by split, seed and index.

Pieces stand all round the arm, none in the column of its base, and in every scene a hand reaches something.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.splits import Split, scenario_rng
from cspace.strict_json import read_object, settle, written
from cspace.worlds.spatial.furniture import Bins, Cages, Shelves, Tables
from cspace.worlds.spatial.layout import GoalRegion, Layout, Piece
from cspace.worlds.spatial.objects import Range, block, floating
from cspace.worlds.spatial.poses import MAX_PLACE_M, make_pose, turned
from cspace.worlds.spatial.shapes import MAX_OBSTACLES, Box, Cylinder, Obstacles
from cspace.worlds.spatial.signed_distance import clearance_m, distance_m

FAMILIES = ("shelf", "table", "under_table", "bin", "cage", "clutter", "mixture")
_MAX_DRAWS = 300
# The column that the arm's base and shoulder turn in: balls above each other.
_COLUMN_M = np.array([[(0.0, 0.0, z) for z in (0.1, 0.2, 0.3, 0.4)]])
_COLUMN_RADIUS_M = 0.15
_PLACES = 32


@dataclass(frozen=True, slots=True)
class SpatialScenes:
    """Which scenes are drawn, and how wide.

    Args:
        shares: how often each family of :data:`FAMILIES` is drawn, in their order; they need not sum to 1.
        bearing_deg: largest angle between the front of the arm and a piece, to either side.
        distance_m: from the base to the front of a piece.
        yaw_deg: largest turn of a piece away from facing the arm.
        stray: share of scenes with loose things in the air, besides clutter and mixtures.
        strays: fewest and most of them.
        floor: share of scenes with a floor.
        wall: share of scenes with a wall behind the arm.
        shoulder_m: height above the base from which reach is measured.
        reach_m: a region counts if it has a free place no farther than this from the shoulder.
        room_m: clearance of such a place.
        shelves: ranges of shelves.
        tables: ranges of tables.
        bins: ranges of bins.
        cages: ranges of cages.

    Raises:
        ScenarioError: a range is not in order, or a share is none.
    """

    shares: tuple[float, ...] = (0.26, 0.12, 0.12, 0.2, 0.14, 0.06, 0.1)
    bearing_deg: float = 115.0
    distance_m: Range = (0.2, 0.7)
    yaw_deg: float = 35.0
    stray: float = 0.25
    strays: tuple[int, int] = (1, 8)
    floor: float = 0.4
    wall: float = 0.15
    shoulder_m: float = 0.333
    reach_m: float = 0.9
    room_m: float = 0.04
    shelves: Shelves = field(default_factory=Shelves)
    tables: Tables = field(default_factory=Tables)
    bins: Bins = field(default_factory=Bins)
    cages: Cages = field(default_factory=Cages)

    def __post_init__(self) -> None:
        settle(self)
        every = (*self.shares, self.stray, self.floor, self.wall)
        shares = len(self.shares) == len(FAMILIES) and all(0.0 <= one <= 1.0 for one in every)
        angles = 0.0 <= self.bearing_deg <= 180.0 and 0.0 <= self.yaw_deg <= 180.0
        lengths = 0.0 <= self.room_m < self.reach_m < np.inf and abs(self.shoulder_m) < np.inf
        lengths = lengths and 0.0 <= self.distance_m[0] <= self.distance_m[1] < MAX_PLACE_M / 2.0
        strays = 0 <= self.strays[0] <= self.strays[1] <= MAX_OBSTACLES
        if not (shares and angles and lengths and strays) or sum(self.shares) <= 0.0:
            raise ScenarioError(
                "the families of scenes do not fit",
                expected=f"{len(FAMILIES)} shares, angles up to 180 degrees, ranges in order, and a reach",
                got=str(self)[:200],
            )

    def draw(self, split: Split, seed: int, index: int, family: str | None = None) -> Layout:
        """The scene of a split, a seed and an index; of one family where it is named.

        Raises:
            ScenarioError: there is no such family, or none of its scenes fits the settings.
        """
        if family is not None and family not in FAMILIES:
            raise ScenarioError(
                "the family of scenes is unknown", expected=f"one of {', '.join(FAMILIES)}", got=family[:200]
            )
        rng = scenario_rng(split, seed, index)
        shares = np.array(self.shares) / sum(self.shares)
        drawn = FAMILIES[int(rng.choice(len(FAMILIES), p=shares))]
        name = drawn if family is None else family
        for _ in range(_MAX_DRAWS):
            found = self._attempt(rng, name)
            if found is not None:
                return found
        raise ScenarioError(f"no scene of the family {name} fits its settings", got=str(self)[:200])

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)

    def _attempt(self, rng: np.random.Generator, family: str) -> Layout | None:
        """A scene, or None where the base stands in something or the hand reaches nothing."""
        bearing = np.radians(rng.uniform(-self.bearing_deg, self.bearing_deg))
        pieces = self._pieces(rng, family, bearing)
        if not _spares_base(Obstacles.of(pieces.shapes)):
            return None
        shapes = [*pieces.shapes, *self._surroundings(rng, family, bearing, pieces.regions)]
        obstacles = Obstacles.of(shapes)
        regions = tuple(one for one in pieces.regions if self._is_reached(rng, one, obstacles))
        if not regions:
            return None
        centres = np.array([[row[3] for row in one.box.pose[:3]] for one in regions])
        focus = centres[int(rng.integers(len(centres)))]
        return Layout(family, obstacles, regions, (float(focus[0]), float(focus[1]), float(focus[2])))

    def _pieces(self, rng: np.random.Generator, family: str, bearing: float) -> Piece:
        if family == "clutter":
            return Piece((), tuple(self._open_places(rng)))
        if family != "mixture":
            return self._placed(rng, self._furniture(rng, family), bearing)
        # Two or three in turn round the arm, at least 75 degrees from each other.
        found, step = Piece((), ()), np.radians(rng.uniform(75.0, 115.0)) * rng.choice((-1.0, 1.0))
        for place in range(int(rng.integers(2, 4))):
            other = FAMILIES[int(rng.integers(5))]
            found += self._placed(rng, self._furniture(rng, other), bearing + place * step)
        return found

    def _furniture(self, rng: np.random.Generator, family: str) -> Piece:
        makers: Mapping[str, Callable[[], Piece]] = {
            "shelf": lambda: self.shelves.draw(rng),
            "table": lambda: self.tables.draw(rng, under=False),
            "under_table": lambda: self.tables.draw(rng, under=True),
            "bin": lambda: self.bins.draw(rng),
            "cage": lambda: self.cages.draw(rng),
        }
        return makers[family]()

    def _placed(self, rng: np.random.Generator, piece: Piece, bearing: float) -> Piece:
        away = rng.uniform(*self.distance_m)
        yaw = bearing + np.radians(rng.uniform(-self.yaw_deg, self.yaw_deg))
        return piece.moved(make_pose(turned(yaw), (away * np.cos(bearing), away * np.sin(bearing), 0.0)))

    def _open_places(self, rng: np.random.Generator) -> list[GoalRegion]:
        """Cubes of 30 cm all round, into which a hand comes from above or from the base."""
        found = []
        for _ in range(3):
            bearing, away = (
                np.radians(rng.uniform(-self.bearing_deg, self.bearing_deg)),
                rng.uniform(0.35, 0.7),
            )
            ahead = (float(np.cos(bearing)), float(np.sin(bearing)), 0.0)
            place = make_pose(turned(bearing), (away * ahead[0], away * ahead[1], rng.uniform(0.1, 0.7)))
            cube = block((-0.15, 0.15), (-0.15, 0.15), (-0.15, 0.15), pose=place)
            found.append(GoalRegion(cube, ahead if rng.random() < 0.5 else (0.0, 0.0, -1.0)))
        return found

    def _surroundings(
        self, rng: np.random.Generator, family: str, bearing: float, regions: tuple[GoalRegion, ...]
    ) -> list[Box | Cylinder]:
        """Loose things, a floor below all goals, and a wall behind the arm; none in the base's column."""
        found: list[Box | Cylinder] = []
        if family == "clutter":
            found += floating(rng, int(rng.integers(6, 30)), (0.3, 1.2), np.radians(self.bearing_deg + 30.0))
        elif family == "mixture" or rng.random() < self.stray:
            count = int(rng.integers(*self.strays, endpoint=True))
            found += floating(rng, count, (0.3, 1.3), np.radians(self.bearing_deg + 30.0))
        if rng.random() < self.floor:
            low = min((_lowest(one) for one in regions), default=0.0)
            top = min(-0.06, low - 0.05) - rng.uniform(0.0, 0.6) * (rng.random() < 0.5)
            found.append(block((-1.5, 1.5), (-1.5, 1.5), (top - 0.02, top)))
        if rng.random() < self.wall:
            side = bearing + np.pi + np.radians(rng.uniform(-50.0, 50.0))
            away, turn = rng.uniform(0.3, 0.9), make_pose(turned(side), (0.0, 0.0, 0.0))
            found.append(block((away, away + 0.1), (-1.2, 1.2), (-0.8, 1.4), pose=turn))
        return [one for one in found if _spares_base(Obstacles.of((one,)))]

    def _is_reached(self, rng: np.random.Generator, region: GoalRegion, obstacles: Obstacles) -> bool:
        places = region.draw(rng, _PLACES)
        near = np.linalg.norm(places - (0.0, 0.0, self.shoulder_m), axis=1) <= self.reach_m
        free = distance_m(obstacles, places) >= self.room_m
        return bool((near & free & _off_base(places)).any())


def read_spatial_scenes(values: object) -> SpatialScenes:
    """The inverse of :meth:`SpatialScenes.to_dict`.

    Raises:
        ScenarioError: a key or a value does not fit.
    """
    return read_object(SpatialScenes, values, "the scenes", ScenarioError)


def base_clearance_m(obstacles: Obstacles) -> float:
    """Signed distance between the obstacles and the column in which the arm's base and shoulder stand, m."""
    return float(clearance_m(obstacles, _COLUMN_M, np.full(_COLUMN_M.shape[1], _COLUMN_RADIUS_M))[0])


def _spares_base(obstacles: Obstacles) -> bool:
    return base_clearance_m(obstacles) > 0.0


def _off_base(places: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.hypot(places[:, 0], places[:, 1]) >= 2.0 * _COLUMN_RADIUS_M)


def _lowest(region: GoalRegion) -> float:
    pose, half = np.array(region.box.pose), np.array(region.box.half_m)
    return float(pose[2, 3] - np.abs(pose[2, :3]) @ half)
