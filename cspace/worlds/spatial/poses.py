"""Rigid transforms: poses in the base frame as rows of 4 x 4 matrices, and frames as people write them."""

import sys
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, StrictFloat

from cspace.errors import CspaceError, ScenarioError
from cspace.files import validated

Row = tuple[StrictFloat, StrictFloat, StrictFloat, StrictFloat]
Pose = tuple[Row, Row, Row, Row]
Vector = tuple[StrictFloat, StrictFloat, StrictFloat]

HERE: Pose = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
# A rotation that was written with four digits is one.
_ROTATION_TOLERANCE = _QUATERNION_TOLERANCE = 1e-3
# Farther away than that nothing is seen or touched.
MAX_PLACE_M = 100.0


def check_pose(pose: Pose, what: str, error: type[CspaceError] = ScenarioError) -> None:
    """Refuse 4 x 4 finite numbers that are no rotation and a place within 100 m."""
    matrix = np.array(pose)
    turn, place = matrix[:3, :3], matrix[:3, 3]
    # Before any product, which could overflow.
    bounded = np.abs(turn).max() <= 1.0 + _ROTATION_TOLERANCE
    if (
        not bounded
        or np.abs(turn @ turn.T - np.eye(3)).max() > _ROTATION_TOLERANCE
        or np.linalg.det(turn) < 0
    ):
        raise error(
            f"{what} has a pose that is no rotation", expected="orthonormal axes", got=str(turn.tolist())
        )
    if tuple(matrix[3]) != HERE[3]:
        raise error(f"{what} has a pose that is none", expected="a last row 0 0 0 1", got=str(pose[3]))
    if np.abs(place).max() > MAX_PLACE_M:
        raise error(f"{what} is too far away", expected=f"at most {MAX_PLACE_M:g} m", got=str(place.tolist()))


def read_pose(values: object, what: str, error: type[CspaceError] = ScenarioError) -> Pose:
    """A pose of plain values: rows of 4 x 4 numbers, or ``translation`` in m with ``quaternion_xyzw``."""
    is_placed = isinstance(values, Mapping) and set(values) == {"translation", "quaternion_xyzw"}
    rows: Any = (values["translation"], values["quaternion_xyzw"]) if is_placed else values  # type: ignore[index]
    lengths = [3, 4] if is_placed else [4] * 4
    are_rows = isinstance(rows, list | tuple) and all(isinstance(row, list | tuple) for row in rows)
    if (
        not are_rows
        or [len(row) for row in rows] != lengths
        or any(isinstance(one, bool) or not isinstance(one, int | float) for one in chain(*rows))
        or not all(abs(one) <= sys.float_info.max for one in chain(*rows))
    ):
        raise error(
            f"{what} has no pose",
            expected="4 x 4 finite numbers, or translation [x, y, z] in m with quaternion_xyzw [x, y, z, w]",
            got=repr(values)[:200],
        )
    if is_placed:
        place, quaternion = rows
        # Before the norm, which could overflow.
        if max(map(abs, quaternion)) > 2.0 or abs(np.linalg.norm(quaternion) - 1.0) > _QUATERNION_TOLERANCE:
            raise error(
                f"{what} has a quaternion that is no rotation",
                expected="a norm of 1",
                got=repr(quaternion)[:200],
            )
        rows = quaternion_pose(place, quaternion)
    pose = pose_of(rows)
    check_pose(pose, what, error)
    return pose


def pose_of(matrix: ArrayLike) -> Pose:
    """The rows of a (4, 4) array."""
    rows = np.asarray(matrix, dtype=np.float64)
    return tuple(tuple(row) for row in rows.tolist())  # type: ignore[return-value] # four of four


def vector(values: Iterable[Any]) -> Vector:
    """Three numbers of any kind as floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def make_pose(rotation: ArrayLike, place_m: ArrayLike) -> NDArray[np.float64]:
    """(4, 4) of a rotation (3, 3) and a place (3,) m."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place_m
    return pose


def nearest_rotation(written: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation (3, 3) closest to one that was written with a few digits."""
    left, _, right = np.linalg.svd(written)
    return np.asarray(left @ right)


def turned(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> NDArray[np.float64]:
    """(3, 3): the rotation about x by roll, then about y by pitch, then about z by yaw, axes fixed."""
    (cz, cy, cx), (sz, sy, sx) = (
        np.cos((yaw_rad, pitch_rad, roll_rad)),
        np.sin((yaw_rad, pitch_rad, roll_rad)),
    )
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    return np.asarray(about_z @ about_y @ about_x)


def quaternion_pose(place_m: ArrayLike, quaternion_xyzw: ArrayLike) -> NDArray[np.float64]:
    """(4, 4) of a place (3,) m and a quaternion x, y, z, w of any norm above 0."""
    quaternion = np.asarray(quaternion_xyzw, dtype=np.float64)
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return make_pose(turn, place_m)


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quaternion x, y, z, w of a rotation (3, 3), up to its sign."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    outer = np.array(
        [
            [1 + a - e - i, b + d, c + g, h - f],
            [b + d, 1 - a + e - i, f + h, c - g],
            [c + g, f + h, 1 - a - e + i, d - b],
            [h - f, c - g, d - b, 1 + a + e + i],
        ]
    )
    row = outer[np.argmax(np.diag(outer))]
    return np.asarray(row / np.linalg.norm(row))


def turn_deg(rotation: NDArray[np.float64]) -> float:
    """How far a rotation (3, 3) turns."""
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))))


# Of one transform of a robot, m.
MAX_OFFSET_M = 100.0
Offset = Annotated[float, Field(ge=-MAX_OFFSET_M, le=MAX_OFFSET_M)]
# Cosine of the pitch below which roll and yaw turn about one axis.
_LOCKED = 1e-9


@validated(ScenarioError)
class Frame:
    """A frame in its parent's."""

    xyz_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)  # its origin
    rpy_rad: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)  # about the parent's fixed axes, as in URDF

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4), from this frame's coordinates to its parent's."""
        roll, pitch, yaw = (turn(axis, angle) for axis, angle in zip(np.eye(3), self.rpy_rad, strict=True))
        return make_pose(yaw @ pitch @ roll, self.xyz_m)

    @classmethod
    def of(cls, matrix: NDArray[np.float64]) -> "Frame":
        level = float(np.hypot(matrix[0, 0], matrix[1, 0]))
        pitch = np.arctan2(-matrix[2, 0], level)
        if level > _LOCKED:
            roll, yaw = np.arctan2(matrix[2, 1], matrix[2, 2]), np.arctan2(matrix[1, 0], matrix[0, 0])
        else:
            roll, yaw = np.arctan2(-matrix[1, 2], matrix[1, 1]), 0.0
        return cls(vector(matrix[:3, 3]), vector((roll, pitch, yaw)))


# The parent's own.
SAME = Frame()


def turn(axis: ArrayLike, angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Rotations about unit axes (3,) or (..., 3) by angles (...) rad, (..., 3, 3), by Rodrigues' formula."""
    cross = np.cross(np.eye(3), np.asarray(axis, dtype=np.float64)[..., None, :])
    angle = np.asarray(angle_rad, dtype=np.float64)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


def moved(matrices: NDArray[np.float64], points_m: ArrayLike) -> NDArray[np.float64]:
    """Points (..., 3) by transforms (..., 4, 4)."""
    points = np.asarray(points_m, dtype=np.float64)
    return np.asarray(np.einsum("...ij,...j->...i", matrices[..., :3, :3], points) + matrices[..., :3, 3])
