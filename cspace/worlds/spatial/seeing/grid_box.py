"""The grid round an arm: equal voxels in the base frame that hold all that it can touch. Numpy alone."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.strict_json import read_object, settle, written
from cspace.worlds.spatial.poses import MAX_PLACE_M, Vector
from cspace.worlds.spatial.robot.arm import SerialArm

VOXEL_M = 0.025
MIN_VOXEL_M, MAX_VOXEL_M = 0.01, 0.2
MAX_COUNT, MAX_VOXELS = 512, 2**23
# Networks halve a grid three times.
_MULTIPLE = 8


@dataclass(frozen=True, slots=True)
class GridBox:
    """An axis-aligned grid of voxels in the base frame.

    Args:
        low_m: its lowest corner.
        voxel_m: side of a voxel.
        counts: X, Y, Z, of voxels.

    Raises:
        ScenarioError: a number is out of range, or there are more than 2**23 voxels.
    """

    low_m: Vector
    voxel_m: float
    counts: tuple[int, int, int]

    def __post_init__(self) -> None:
        settle(self)
        try:
            placed = np.shape(self.low_m) == (3,) and bool((np.abs(self.low_m) <= MAX_PLACE_M).all())
            sized = MIN_VOXEL_M <= self.voxel_m <= MAX_VOXEL_M
            whole = np.shape(self.counts) == (3,) and all(
                type(one) is int and 1 <= one <= MAX_COUNT for one in self.counts
            )
            sound = placed and sized and whole and bool(np.prod(self.counts) <= MAX_VOXELS)
        except TypeError:
            sound = False
        if not sound:
            raise ScenarioError(
                "the grid does not fit",
                expected=f"a corner, voxels of {MIN_VOXEL_M} to {MAX_VOXEL_M} m, each count 1 to {MAX_COUNT}",
                got=str(self)[:200],
            )

    @property
    def high_m(self) -> NDArray[np.float64]:
        """(3,): its highest corner."""
        return np.asarray(np.array(self.low_m) + self.voxel_m * np.array(self.counts))

    def centres_m(self) -> NDArray[np.float64]:
        """(X, Y, Z, 3): of all voxels."""
        index = np.stack(np.meshgrid(*(np.arange(count) for count in self.counts), indexing="ij"), axis=-1)
        return np.asarray(np.array(self.low_m) + self.voxel_m * (index + 0.5))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def read_grid_box(values: object) -> GridBox:
    """The inverse of :meth:`GridBox.to_dict`.

    Raises:
        ScenarioError: a key or a value does not fit.
    """
    return read_object(GridBox, values, "the grid", ScenarioError)


def grid_of(arm: SerialArm, voxel_m: float = VOXEL_M) -> GridBox:
    """The cube about an arm's shoulder that holds all that the arm can touch.

    Its half side is :func:`shoulder_reach_m` and a little more, so that counts are multiples of eight.

    Raises:
        ScenarioError: the voxels are too small or too large.
    """
    if not MIN_VOXEL_M <= voxel_m <= MAX_VOXEL_M:
        raise ScenarioError(
            "the grid does not fit", expected=f"voxels of {MIN_VOXEL_M} to {MAX_VOXEL_M} m", got=repr(voxel_m)
        )
    count = _MULTIPLE * int(np.ceil(2.0 * shoulder_reach_m(arm) / (_MULTIPLE * voxel_m)))
    x, y, z = (float(place) - count * voxel_m / 2.0 for place in arm.joints[0].origin.xyz_m)
    return GridBox((x, y, z), voxel_m, (count, count, count))


def shoulder_reach_m(arm: SerialArm) -> float:
    """No less than the distance from the origin of the first joint to any point of the arm, m.

    Along the arm it adds the lesser of lengths of single links and of the largest distances over pairs of
    links, over all angles of the joint between them. So links that are offset to and fro count once.
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
