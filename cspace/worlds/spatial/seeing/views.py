"""Where depth cameras stand that look at a scene, as a value: one to three, and how wide. Numpy alone.

They are put there by :mod:`cspace.worlds.spatial.seeing.placing`.
"""

from dataclasses import dataclass
from typing import Any

from cspace.errors import ScenarioError
from cspace.strict_json import read_object, settle, written
from cspace.worlds.spatial.obstacles.objects import Range
from cspace.worlds.spatial.poses import MAX_PLACE_M
from cspace.worlds.spatial.seeing.camera import MAX_FIELD_DEG, MAX_SIDE, MIN_FIELD_DEG, MIN_SIDE


@dataclass(frozen=True, slots=True)
class CameraViews:
    """A distribution of cameras.

    Args:
        count: fewest and most cameras of a scene.
        side_deg: angle on the ground between the line from what is looked at to the robot and that to the
            camera, to either side by chance.
        up_deg: of the camera above the level of what it looks at.
        distance_m: from it.
        field_deg: width of the field of view.
        aim_m: sigma of the point that is looked at, along each axis.
        roll_deg: largest turn about the optical axis.
        clear_m: least distance of a camera to any obstacle.
        width: of the pictures, pixels.
        height: of the pictures, pixels.

    Raises:
        ScenarioError: a range is not in order, or no camera is like that.
    """

    count: tuple[int, int] = (1, 3)
    side_deg: Range = (15.0, 75.0)
    up_deg: Range = (10.0, 50.0)
    distance_m: Range = (0.9, 1.6)
    field_deg: Range = (52.0, 85.0)
    aim_m: float = 0.15
    roll_deg: float = 8.0
    clear_m: float = 0.05
    width: int = 128
    height: int = 128

    def __post_init__(self) -> None:
        settle(self)
        ordered = all(
            low <= high
            for low, high in (self.count, self.side_deg, self.up_deg, self.distance_m, self.field_deg)
        )
        angles = self.side_deg[0] >= -180.0 and self.side_deg[1] <= 180.0
        angles = angles and self.up_deg[0] >= -90.0 and self.up_deg[1] <= 90.0
        angles = angles and 0.0 <= self.roll_deg <= 180.0
        fields = self.field_deg[0] >= MIN_FIELD_DEG and self.field_deg[1] <= MAX_FIELD_DEG
        lengths = self.distance_m[0] > 0.0 and self.distance_m[1] < MAX_PLACE_M / 2.0
        lengths = lengths and 0.0 <= self.aim_m < 1.0 and self.clear_m >= 0.0
        sides = all(MIN_SIDE <= side <= MAX_SIDE for side in (self.width, self.height))
        if not (ordered and angles and fields and lengths and sides and self.count[0] >= 1):
            raise ScenarioError("the views of cameras do not fit", got=str(self)[:300])

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def read_camera_views(values: object) -> CameraViews:
    """The inverse of :meth:`CameraViews.to_dict`.

    Raises:
        ScenarioError: a key or a value does not fit.
    """
    return read_object(CameraViews, values, "the cameras", ScenarioError)
