"""Depth cameras about an arm as a sensor: where they stand, and the grid of their pictures. NumPy alone."""

from dataclasses import field
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.files import Record, Share, Span, validated
from cspace.view_file import MAX_PICTURES
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import MAX_FIELD_DEG, MIN_FIELD_DEG, Side
from cspace.worlds.spatial.poses import MAX_PLACE_M

FREE, NO_READING, OUT_OF_VIEW = 0, 254, 255
MOST_BEHIND = 253
BEHIND_STEP_M = 0.01

DISTANCE_STEP_M = 0.0004
FARTHEST = 255


@validated(ScenarioError)
class CameraViews(Record):
    """A distribution of cameras."""

    count: Span[Annotated[int, Field(ge=1, le=MAX_PICTURES)]] = (1, 3)
    # Angle on the ground between the line from what is looked at to the robot and that to the camera, to
    # either side by chance
    side_deg: Span[Annotated[float, Field(ge=-180.0, le=180.0)]] = (15.0, 75.0)
    up_deg: Span[Annotated[float, Field(ge=-90.0, le=90.0)]] = (10.0, 50.0)
    distance_m: Span[Annotated[float, Field(gt=0.0, lt=MAX_PLACE_M / 2.0)]] = (0.9, 1.6)
    field_deg: Span[Annotated[float, Field(ge=MIN_FIELD_DEG, le=MAX_FIELD_DEG)]] = (52.0, 85.0)
    aim_m: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.15
    roll_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 8.0
    clear_m: Annotated[float, Field(ge=0.0)] = 0.05
    width: Side = 128
    height: Side = 128


VOXEL_M = 0.025
MIN_VOXEL_M, MAX_VOXEL_M = 0.01, 0.2
MAX_COUNT, MAX_VOXELS = 512, 2**23
_Place = Annotated[float, Field(ge=-MAX_PLACE_M, le=MAX_PLACE_M)]
_Count = Annotated[int, Field(ge=1, le=MAX_COUNT, strict=True)]
# Networks halve a grid four times.
NETWORK_MULTIPLE = 16
# The largest such count whose cube has no more voxels than a grid may have.
_MOST_A_SIDE = 192


@validated(ScenarioError)
class GridBox(Record):
    """An axis-aligned grid of voxels in the base frame."""

    low_m: tuple[_Place, _Place, _Place]
    voxel_m: Annotated[float, Field(ge=MIN_VOXEL_M, le=MAX_VOXEL_M, strict=True)]
    counts: tuple[_Count, _Count, _Count]

    def __post_init__(self) -> None:
        if np.prod(self.counts) > MAX_VOXELS:
            raise ScenarioError(
                "the grid does not fit", expected=f"at most {MAX_VOXELS} voxels", got=str(self)[:200]
            )

    @property
    def high_m(self) -> NDArray[np.float64]:
        return np.asarray(np.array(self.low_m) + self.voxel_m * np.array(self.counts))

    def centres_m(self) -> NDArray[np.float64]:
        index = np.stack(np.meshgrid(*(np.arange(count) for count in self.counts), indexing="ij"), axis=-1)
        return np.asarray(np.array(self.low_m) + self.voxel_m * (index + 0.5))


def grid_of(arm: SerialArm) -> GridBox:
    """The cube about an arm's shoulder that holds all that the arm can touch, in voxels of 2.5 cm or more."""
    reach_m = shoulder_reach_m(arm)
    voxel_m = max(VOXEL_M, float(np.ceil(1e3 * 2.0 * reach_m / _MOST_A_SIDE) / 1e3))
    count = NETWORK_MULTIPLE * int(np.ceil(2.0 * reach_m / (NETWORK_MULTIPLE * voxel_m)))
    x, y, z = (float(place) - count * voxel_m / 2.0 for place in arm.joints[0].origin.xyz_m)
    return GridBox((x, y, z), voxel_m, (count, count, count))


def shoulder_reach_m(arm: SerialArm) -> float:
    """No less than the distance from the first joint's origin to any point of the arm, m.

    Links that are offset to and fro count once: along the arm it adds what two of them span at most.
    """
    far = [0.0]
    for index in range(1, arm.dim):
        place = np.asarray(arm.joints[index].origin.xyz_m)
        far.append(_least_far(arm, far, index - 1, place[None])[0])
    shoulder = np.asarray(arm.joints[0].origin.xyz_m)
    tips = [_least_far(arm, far, arm.dim - 1, np.asarray(arm.tool.xyz_m)[None])]
    for part in arm.parts:
        spheres = np.asarray(part.spheres_m).reshape(-1, 4)
        if part.link == 0:
            away = np.linalg.norm(spheres[:, :3] - shoulder, axis=1)
        else:
            away = _least_far(arm, far, part.link - 1, spheres[:, :3])
        tips.append(away + spheres[:, 3])
    return float(np.concatenate(tips).max())


def _least_far(
    arm: SerialArm, far: list[float], index: int, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far from the shoulder points (P, 3) can be that the joint of an index, from 0, moves, (P,)."""
    found = far[index] + np.linalg.norm(points, axis=1)
    if index == 0:
        return np.asarray(found)
    joint = arm.joints[index]
    # The joint before, in the frame of this one, about whose axis the points turn.
    base = joint.origin.matrix()[:3, :3].T @ np.asarray(joint.origin.xyz_m)
    axis = np.asarray(joint.axis, dtype=np.float64)
    along_base, along = base @ axis, points @ axis
    off_base = np.linalg.norm(base - along_base * axis)
    off = np.linalg.norm(points - along[:, None] * axis, axis=1)
    direct = np.hypot(along_base + along, off_base + off)
    return np.asarray(np.minimum(found, far[index - 1] + direct))


Noise = Literal["structured_light", "disparity", "stereo"]
NOISES: tuple[Noise, ...] = get_args(Noise)


@validated(ScenarioError)
class DepthSensor(Record):
    """What stands for the picture of a scene: an array (X, Y, Z, 2) of what its depth pictures say."""

    grid: GridBox
    views: CameraViews = field(default_factory=CameraViews)
    noise: tuple[Noise, ...] = NOISES  # of which a scene has one; none for exact pictures
    arm_hides: Literal[True] = True
    holes: Share = 0.3  # of pictures, that have rectangles without readings, as black things do

    @property
    def pixels(self) -> int:
        """Most voxels along a side of the grid."""
        return max(self.grid.counts)

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """(X, Y, Z, 2): distance to what is seen, and what is known."""
        return (*self.grid.counts, 2)

    @property
    def convention(self) -> dict[str, Any]:
        """What a bundle says of its pictures, and of the cameras that it has learned from."""
        views = self.views
        return {
            "grid": self.grid.to_dict(),
            "channels": ["distance to the nearest surface seen", "what is known of the voxel"],
            "distance_step_m": DISTANCE_STEP_M,
            "farther": FARTHEST,
            "behind_step_m": BEHIND_STEP_M,
            "arm_hides": self.arm_hides,
            "codes": {"seen free": FREE, "no reading": MOST_BEHIND + 1, "out of view": OUT_OF_VIEW},
            "cameras": {
                "count": list(views.count),
                "pixels": [views.width, views.height],
                "field_deg": list(views.field_deg),
                "distance_m": list(views.distance_m),
            },
            "range": [0, 1],
        }

    @property
    def extent_m(self) -> None:
        return

    def to_network(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(..., X, Y, Z, 2) uint8 to (..., 2, X, Y, Z) float32 in [0, 1]."""
        scaled = np.moveaxis(images, -1, -4).astype(np.float32)
        scaled *= np.float32(1.0 / 255.0)
        return np.ascontiguousarray(scaled)
