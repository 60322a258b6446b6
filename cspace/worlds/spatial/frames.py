"""Rigid transforms: a place and a turn, as numbers that people write and as 4 x 4 matrices."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.strict_json import settle

# Of one transform of a robot, m.
MAX_OFFSET_M = 100.0
# Cosine of the pitch below which roll and yaw turn about one axis.
_LOCKED = 1e-9


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame in its parent's.

    Args:
        xyz_m: its origin.
        rpy_rad: roll, pitch and yaw about the parent's fixed x, y and z axes, in this order, as in URDF.

    Raises:
        ScenarioError: a number is not finite, or the origin is further than 100 m away.
    """

    xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        settle(self)
        numbers = np.asarray([*self.xyz_m, *self.rpy_rad])
        if numbers.shape != (6,) or not np.isfinite(numbers).all() or np.abs(numbers).max() > MAX_OFFSET_M:
            raise ScenarioError(
                "the frame does not fit",
                expected=f"three places and three angles, each within {MAX_OFFSET_M:.0f} m or rad",
                got=f"{self.xyz_m}, {self.rpy_rad}",
            )

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4), from this frame's coordinates to its parent's."""
        result = np.eye(4)
        roll, pitch, yaw = (turn(axis, angle) for axis, angle in zip(np.eye(3), self.rpy_rad, strict=True))
        result[:3, :3] = yaw @ pitch @ roll
        result[:3, 3] = self.xyz_m
        return result

    @classmethod
    def of(cls, matrix: NDArray[np.float64]) -> "Frame":
        """The inverse of :meth:`matrix`."""
        level = float(np.hypot(matrix[0, 0], matrix[1, 0]))
        pitch = np.arctan2(-matrix[2, 0], level)
        if level > _LOCKED:
            roll, yaw = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
        else:
            roll, yaw = np.arctan2(-matrix[1, 2], matrix[1, 1]), 0.0
        x, y, z = (float(value) for value in matrix[:3, 3])
        return cls((x, y, z), (float(roll), float(pitch), float(yaw)))


# The parent's own.
SAME = Frame()


def turn(axis: ArrayLike, angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Rotations about one unit axis (3,) by angles (...) rad, (..., 3, 3), by Rodrigues' formula."""
    x, y, z = np.asarray(axis, dtype=np.float64)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle_rad, dtype=np.float64)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


def moved(matrices: NDArray[np.float64], points_m: ArrayLike) -> NDArray[np.float64]:
    """Points (..., 3) by transforms (..., 4, 4)."""
    points = np.asarray(points_m, dtype=np.float64)
    return np.asarray(np.einsum("...ij,...j->...i", matrices[..., :3, :3], points) + matrices[..., :3, 3])
