"""Which scenes are drawn, as a value: families and how wide they are. Numpy alone.

What they look like is in :mod:`cspace.worlds.spatial.obstacles.families`.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cspace.errors import ScenarioError
from cspace.strict_json import read_object, settle, written
from cspace.worlds.spatial.obstacles.furniture import Bins, Cages, Shelves, Tables
from cspace.worlds.spatial.obstacles.objects import Range
from cspace.worlds.spatial.obstacles.shapes import MAX_OBSTACLES
from cspace.worlds.spatial.poses import MAX_PLACE_M

FAMILIES = ("shelf", "table", "under_table", "bin", "cage", "clutter", "mixture")


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

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def read_spatial_scenes(values: object) -> SpatialScenes:
    """The inverse of :meth:`SpatialScenes.to_dict`.

    Raises:
        ScenarioError: a key or a value does not fit.
    """
    return read_object(SpatialScenes, values, "the scenes", ScenarioError)
