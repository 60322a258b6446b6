"""The depth camera: pinhole model, from pixels to points in the base frame and back.

Camera frame: optical, x right, y down, z forward. Pixel centres are at whole numbers, as in OpenCV and ROS.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ImageError, ScenarioError
from cspace.strict_json import read_object, settle, written
from cspace.worlds.spatial.poses import HERE, Pose, check_pose, make_pose, pose_of

MIN_SIDE, MAX_SIDE = 16, 2048
MIN_FIELD_DEG, MAX_FIELD_DEG = 1.0, 170.0


@dataclass(frozen=True, slots=True)
class DepthCamera:
    """A pinhole camera without distortion.

    Args:
        fx: focal length along a row, pixels.
        fy: focal length along a column, pixels.
        cx: column of the principal point, pixels.
        cy: row of the principal point, pixels.
        width: of the picture, pixels.
        height: of the picture, pixels.
        pose: of the camera's optical frame in the base frame, rows of a 4 x 4 matrix, m.

    Raises:
        ScenarioError: the pose is none, or no camera has such a size, focal length or principal point.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    pose: Pose = HERE

    def __post_init__(self) -> None:
        settle(self)
        check_pose(self.pose, "the camera")
        _check_pinhole(self)

    @classmethod
    def of_field(cls, width: int, height: int, field_deg: float, pose: ArrayLike) -> "DepthCamera":
        """A camera of square pixels, ``field_deg`` wide, with the principal point in the middle."""
        if not MIN_FIELD_DEG <= field_deg <= MAX_FIELD_DEG:
            raise _no_focal(f"{field_deg} degrees")
        focal = width / (2.0 * np.tan(np.radians(field_deg) / 2.0))
        return cls(
            float(focal), float(focal), (width - 1) / 2.0, (height - 1) / 2.0, width, height, pose_of(pose)
        )

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4): the pose."""
        return np.array(self.pose, dtype=np.float64)

    @property
    def picture_shape(self) -> tuple[int, int]:
        """(H, W) of its pictures."""
        return (self.height, self.width)

    def rays(self) -> NDArray[np.float64]:
        """(H, W, 3): through each pixel's centre, in the camera frame, with z = 1."""
        x = (np.arange(self.width) - self.cx) / self.fx
        y = (np.arange(self.height) - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0], rays[..., 1] = x[None, :], y[:, None]
        return rays

    def points_m(self, depth_m: ArrayLike) -> NDArray[np.float64]:
        """Back-projection: a depth picture (H, W) m to points (H, W, 3) m in the base frame.

        NaN where there is no reading, which is where the depth is not a finite number above 0.

        Raises:
            ImageError: the picture has another shape than the camera's.
        """
        depth = np.asarray(depth_m, dtype=np.float64)
        if depth.shape != self.picture_shape:
            raise ImageError(
                "the depth picture does not fit the camera",
                expected=f"{self.width} x {self.height} pixels",
                got=f"an array of shape {depth.shape}",
            )
        seen = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)
        pose = self.matrix
        return np.asarray((self.rays() * seen[..., None]) @ pose[:3, :3].T + pose[:3, 3])

    def project(self, points_m: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) m in the base frame to (..., 3): column, row in pixels, depth in m.

        Column and row are NaN behind the camera; they may lie beside the picture, see :meth:`shows`.
        """
        pose = self.matrix
        seen = (np.asarray(points_m, dtype=np.float64) - pose[:3, 3]) @ pose[:3, :3]
        depth = seen[..., 2]
        ahead = np.where(depth > 0.0, depth, np.nan)
        columns = self.fx * seen[..., 0] / ahead + self.cx
        rows = self.fy * seen[..., 1] / ahead + self.cy
        return np.stack((columns, rows, depth), axis=-1)

    def shows(self, projected: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the projected points (..., 3) lie within the picture, to the outer edges of its pixels."""
        column, row = projected[..., 0], projected[..., 1]
        within = (column >= -0.5) & (column < self.width - 0.5) & (row >= -0.5) & (row < self.height - 0.5)
        return np.asarray(within & (projected[..., 2] > 0.0))

    def resized(self, width: int, height: int) -> "DepthCamera":
        """The camera of the same pictures in another size.

        Raises:
            ScenarioError: the size is out of range.
        """
        across, down = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,
            cy=(self.cy + 0.5) * down - 0.5,
            width=width,
            height=height,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def read_camera(values: object) -> DepthCamera:
    """The inverse of ``to_dict``.

    Raises:
        ScenarioError: a key or a value does not fit.
    """
    return read_object(DepthCamera, values, "the camera", ScenarioError)


def looking(from_m: ArrayLike, at_m: ArrayLike, roll_rad: float = 0.0) -> NDArray[np.float64]:
    """(4, 4): the optical frame of a camera at one point that looks at another.

    Args:
        from_m: (3,) m in the base frame.
        at_m: (3,) m.
        roll_rad: about the optical axis; with 0 the picture's rows are level.

    Raises:
        ScenarioError: the points are one.
    """
    place = np.asarray(from_m, dtype=np.float64)
    ahead = np.asarray(at_m, dtype=np.float64) - place
    length = np.linalg.norm(ahead)
    if not length > 0.0:
        raise ScenarioError("a camera looks at its own place", expected="two points", got=str(place.tolist()))
    ahead = ahead / length
    # Straight up or down no direction is level, and the base's y will do.
    right = np.array([ahead[1], -ahead[0], 0.0])
    right = np.array([0.0, -1.0, 0.0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    down = np.cross(ahead, right)
    across = np.cos(roll_rad) * right + np.sin(roll_rad) * down
    return make_pose(np.stack((across, np.cross(ahead, across), ahead), axis=1), place)


def camera_place(focus_m: ArrayLike, side_rad: float, up_rad: float, away_m: float) -> NDArray[np.float64]:
    """Where a camera is, (3,) m in the base frame.

    Args:
        focus_m: (3,) what it looks at.
        side_rad: angle on the ground from the line to the base to the line to the camera, left of it above 0.
        up_rad: above the focus's level.
        away_m: from the focus.
    """
    focus = np.asarray(focus_m, dtype=np.float64)
    bearing = np.arctan2(-focus[1], -focus[0]) + side_rad
    level = np.cos(up_rad)
    return np.asarray(
        focus + away_m * np.array([level * np.cos(bearing), level * np.sin(bearing), np.sin(up_rad)])
    )


def _check_pinhole(camera: DepthCamera) -> None:
    for name, side in (("width", camera.width), ("height", camera.height)):
        if type(side) is not int or not MIN_SIDE <= side <= MAX_SIDE:
            raise ScenarioError(
                f"the camera's {name} is out of range",
                expected=f"{MIN_SIDE} to {MAX_SIDE} pixels",
                got=repr(side)[:200],
            )
    for focal, side in ((camera.fx, camera.width), (camera.fy, camera.height)):
        least, most = (side / (2.0 * np.tan(np.radians(deg) / 2.0)) for deg in (MAX_FIELD_DEG, MIN_FIELD_DEG))
        if type(focal) is not float or not least * (1 - 1e-9) <= focal <= most * (1 + 1e-9):
            raise _no_focal(f"{focal!r} pixels for {side} pixels"[:200])
    # Of a picture that was cut out of a larger one it may lie beside it.
    for centre, side in ((camera.cx, camera.width), (camera.cy, camera.height)):
        if type(centre) is not float or not -side <= centre <= 2 * side:
            raise ScenarioError(
                "the camera's principal point cannot be",
                expected=f"{-side} to {2 * side} pixels",
                got=repr(centre)[:200],
            )


def _no_focal(got: str) -> ScenarioError:
    return ScenarioError(
        "the camera's focal length cannot be",
        expected=f"a field of view of {MIN_FIELD_DEG:g} to {MAX_FIELD_DEG:g} degrees",
        got=got,
    )
