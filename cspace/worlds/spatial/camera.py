"""The depth camera: pinhole model, the ways in which people write it, and its pictures. NumPy alone."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from pydantic import BaseModel, Field, StrictFloat

from cspace.errors import ImageError, ScenarioError
from cspace.files import Record, encode_png, open_png, read_object, read_yaml, validated
from cspace.worlds.spatial.poses import HERE, Pose, check_pose, make_pose, pose_of, read_pose

MIN_SIDE, MAX_SIDE = 16, 2048
Side = Annotated[int, Field(ge=MIN_SIDE, le=MAX_SIDE, strict=True)]
MIN_FIELD_DEG, MAX_FIELD_DEG = 1.0, 170.0


@validated(ScenarioError)
class DepthCamera(Record):
    """A pinhole camera without distortion."""

    fx: StrictFloat  # focal length along a row, pixels
    fy: StrictFloat  # focal length along a column, pixels
    cx: StrictFloat  # column of the principal point, pixels
    cy: StrictFloat  # row of the principal point, pixels
    width: Side  # of the picture, pixels
    height: Side  # of the picture, pixels
    pose: Pose = HERE  # of the camera's optical frame in the base frame, rows of a 4 x 4 matrix, m

    def __post_init__(self) -> None:
        check_pose(self.pose, "the camera")
        _check_pinhole(self)

    @classmethod
    def of_field(cls, width: int, height: int, field_deg: float, pose: ArrayLike) -> "DepthCamera":
        """A camera of square pixels, ``field_deg`` wide, with the principal point in the middle."""
        focal = width / (2.0 * np.tan(np.radians(field_deg) / 2.0))
        return cls(
            float(focal), float(focal), (width - 1) / 2.0, (height - 1) / 2.0, width, height, pose_of(pose)
        )

    @property
    def matrix(self) -> NDArray[np.float64]:
        return np.array(self.pose, dtype=np.float64)

    @property
    def picture_shape(self) -> tuple[int, int]:
        return (self.height, self.width)

    def rays(self) -> NDArray[np.float64]:
        """(H, W, 3): through each pixel's centre, in the camera frame, with z = 1."""
        x = (np.arange(self.width) - self.cx) / self.fx
        y = (np.arange(self.height) - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0], rays[..., 1] = x[None, :], y[:, None]
        return rays

    def points_m(self, depth_m: ArrayLike) -> NDArray[np.float64]:
        """Back-projection: depths (H, W) m to points (H, W, 3) m in the base frame, NaN without a reading."""
        depth = np.asarray(depth_m, dtype=np.float64)
        seen = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)
        pose = self.matrix
        return np.asarray((self.rays() * seen[..., None]) @ pose[:3, :3].T + pose[:3, 3])

    def project(self, points_m: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) m in the base frame to column and row, NaN behind the camera, and depth in m."""
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


def looking(from_m: ArrayLike, at_m: ArrayLike, roll_rad: float = 0.0) -> NDArray[np.float64]:
    """(4, 4): the optical frame of a camera at one point (3,) m that looks at another, level without roll."""
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
    """Where a camera is, (3,) m, that looks at a focus from a side of the line to the base and from above."""
    focus = np.asarray(focus_m, dtype=np.float64)
    bearing = np.arctan2(-focus[1], -focus[0]) + side_rad
    level = np.cos(up_rad)
    return np.asarray(
        focus + away_m * np.array([level * np.cos(bearing), level * np.sin(bearing), np.sin(up_rad)])
    )


def _check_pinhole(camera: DepthCamera) -> None:
    for focal, side in ((camera.fx, camera.width), (camera.fy, camera.height)):
        least, most = (side / (2.0 * np.tan(np.radians(deg) / 2.0)) for deg in (MAX_FIELD_DEG, MIN_FIELD_DEG))
        if not least * (1 - 1e-9) <= focal <= most * (1 + 1e-9):
            raise ScenarioError(
                "the camera's focal length cannot be",
                expected=f"a field of view of {MIN_FIELD_DEG:g} to {MAX_FIELD_DEG:g} degrees",
                got=repr(focal)[:200],
            )
    # Of a picture that was cut out of a larger one it may lie beside it.
    for centre, side in ((camera.cx, camera.width), (camera.cy, camera.height)):
        if not -side <= centre <= 2 * side:
            raise ScenarioError(
                "the camera's principal point cannot be",
                expected=f"{-side} to {2 * side} pixels",
                got=repr(centre)[:200],
            )


PINHOLE = ("fx", "fy", "cx", "cy")
_INFO = "camera_info"
_FRAMES = ("optical", "body")
# x right, y down, z forward in x forward, y left, z up: REP 103 of ROS.
OPTICAL_IN_BODY = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
# Coefficients of each model: k1, k2, p1, p2, k3, and in the second k4, k5, k6.
_COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "": 0, "none": 0}
# What the files of camera_calibration and camera_info_manager call it.
_CALIBRATED = {
    "image_height": "height",
    "image_width": "width",
    "camera_matrix": "k",
    "distortion_coefficients": "d",
}
# Rows that are undistorted at once, in little memory.
_ROWS = 64
_REMEDY = "send the camera in the base frame: x right, y down, z forward, pixel centres at whole numbers"


class _Region(BaseModel):
    x_offset: Literal[0] = 0
    y_offset: Literal[0] = 0


class _CameraInfo(BaseModel):
    """ROS's message, of a whole picture."""

    height: int
    width: int
    k: Annotated[tuple[float, ...], Field(min_length=9, max_length=9)]
    d: Annotated[tuple[float, ...], Field(max_length=14)] = ()
    distortion_model: str = ""
    binning_x: Literal[0, 1] = 0
    binning_y: Literal[0, 1] = 0
    roi: _Region | None = None


def read_pinhole(values: object, shape: tuple[int, ...]) -> tuple[DepthCamera, tuple[float, ...]]:
    """Camera and distortion of a picture (H, W), of ``fx, fy, cx, cy`` or ``camera_info``, with ``pose``."""
    members = values if isinstance(values, Mapping) else {}
    keys = {_INFO, "pose"} if _INFO in members else {*PINHOLE, "pose"}
    missing, unknown = sorted(keys - set(members)), sorted(map(str, set(members) - keys - {"frame"}))
    if missing or unknown:
        raise ImageError(
            "the camera has other keys",
            expected=f"{', '.join(PINHOLE)}, or {_INFO} with a ROS CameraInfo; pose; frame for a body's "
            "pose; link for one on the arm; stamp_s",
            got=f"missing {missing}, unknown {unknown}"[:200] if members else repr(values)[:200],
        )
    numbers: Mapping[str, Any] = members
    distortion: tuple[float, ...] = ()
    if _INFO in members:
        numbers, distortion = _of_info(members[_INFO], shape)
    try:
        focal = {name: float(read_number(numbers[name], name)) for name in PINHOLE}
        camera = DepthCamera(**focal, width=shape[1], height=shape[0], pose=camera_pose(members))
    except (ImageError, ScenarioError) as error:
        raise ImageError(
            error.what, expected=error.expected, got=error.got, remedy=error.remedy or _REMEDY
        ) from error
    return camera, distortion


def camera_pose(camera: Mapping[str, Any]) -> Pose:
    """The pose of a camera's optical frame, of plain values, whose ``frame`` may be ``body``."""
    pose, frame = read_pose(camera.get("pose"), "the camera", ImageError), camera.get("frame", _FRAMES[0])
    if frame not in _FRAMES:
        raise ImageError("the camera's frame is unknown", expected="optical or body", got=repr(frame)[:200])
    return pose if frame == _FRAMES[0] else pose_of(np.array(pose) @ OPTICAL_IN_BODY)


def read_number(value: object, name: str) -> float:
    """A number of plain values."""
    if type(value) not in (int, float):
        raise ImageError(f"{name} does not fit", expected="a finite number", got=repr(value)[:200])
    return value  # type: ignore[return-value] # one of the two


def _of_info(values: object, shape: tuple[int, ...]) -> tuple[dict[str, float], tuple[float, ...]]:
    """Pinhole numbers and distortion of a CameraInfo."""
    if isinstance(values, str):
        # As `ros2 topic echo` ends a message.
        values = read_yaml(values.rstrip().removesuffix("---"), _INFO, ImageError)
    # ROS 1 has K and D in its messages.
    given = {str(key).lower(): value for key, value in values.items()} if isinstance(values, Mapping) else {}
    for name in set(_CALIBRATED) & set(given):
        value = given.pop(name)
        given[_CALIBRATED[name]] = value.get("data") if isinstance(value, Mapping) else value
    info = read_object(_CameraInfo, given, "the camera info", ImageError)
    if (info.height, info.width) != shape:
        raise ImageError(
            "the camera info is of another picture",
            expected=f"height {shape[0]} and width {shape[1]}, as the picture",
            got=f"height {info.height} and width {info.width}",
            remedy="send the CameraInfo of the depth topic, in the mode that the picture was taken in",
        )
    fx, skew, cx, zero, fy, cy, *last = info.k
    if skew or zero or last != [0.0, 0.0, 1.0]:
        raise ImageError("the camera info has another k", expected="fx 0 cx, 0 fy cy, 0 0 1", got=str(info.k))
    # Zeros of a fisheye's model are a distortion.
    most = _COEFFICIENTS.get(info.distortion_model)
    if most is None or any(info.d[most:]):
        raise ImageError(
            f"the camera info follows the distortion model {info.distortion_model!r}"[:100],
            expected="plumb_bob with 5 coefficients or rational_polynomial with 8",
            got=f"d {info.d}"[:200],
            remedy="rectify the picture, and send the CameraInfo of the rectified one, with zeros as d",
        )
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}, info.d[:most] if any(info.d) else ()


def undistorted(
    picture: NDArray[np.uint16],
    camera: DepthCamera,
    distortion: tuple[float, ...],
) -> NDArray[np.uint16]:
    """The picture (H, W) without its lens's distortion k1, k2, p1, p2, k3, k4, k5, k6, as far as there are.

    Every pixel has the reading of the nearest pixel that its ray falls on. Source: OpenCV, calib3d.
    """
    if not distortion:
        return picture
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *(0.0,) * 8)[:8]
    found = np.zeros_like(picture)
    x = ((np.arange(camera.width) - camera.cx) / camera.fx)[None, :]
    for top in range(0, camera.height, _ROWS):
        y = ((np.arange(top, min(top + _ROWS, camera.height)) - camera.cy) / camera.fy)[:, None]
        with np.errstate(all="ignore"):
            square = x * x + y * y
            above = 1.0 + square * (k1 + square * (k2 + square * k3))
            below = 1.0 + square * (k4 + square * (k5 + square * k6))
            radial = above / below
            # By the square of the radius.
            slope = k1 + square * (2.0 * k2 + square * 3.0 * k3)
            slope = (slope - radial * (k4 + square * (2.0 * k5 + square * 3.0 * k6))) / below
            across = 2.0 * (x * y * slope + p1 * x + p2 * y)
            right = radial + 2.0 * (x * x * slope + p1 * y + 3.0 * p2 * x)
            down = radial + 2.0 * (y * y * slope + 3.0 * p1 * y + p2 * x)
            if not ((right * down - across * across > 0.0) & (below > 0.0)).all():
                raise ImageError(
                    "the camera info has a distortion that folds the picture over",
                    expected="coefficients of this picture's lens",
                    got=f"d {distortion}"[:200],
                    remedy="check d, k and the picture's size",
                )
            columns = camera.fx * (x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)) + camera.cx
            rows = camera.fy * (y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y) + camera.cy
        columns, rows = np.floor(columns + 0.5), np.floor(rows + 0.5)
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        source = picture[
            np.where(inside, rows, 0).astype(np.intp), np.where(inside, columns, 0).astype(np.intp)
        ]
        found[top : top + len(y)] = np.where(inside, source, 0)
    return found


# No depth camera for arms reads nearer or farther. What a file says beyond is no reading: 65535, as many
# drivers write it, is not a wall 65 m away behind free space.
NEAREST_MM, FARTHEST_MM = 20, 10_000
MIN_SCALE_M, MAX_SCALE_M = 1e-6, 1.0
MAX_MM = 65_535


def decode_depth(data: bytes) -> NDArray[np.uint16]:
    """An untrusted PNG as (H, W) uint16, mm along the optical axis, 0 where there is no reading."""
    return np.array(open_png(data, _check)).astype(np.uint16)


def _check(picture: Image.Image) -> None:
    check_size(picture.height, picture.width)
    if not picture.mode.startswith("I"):
        raise ImageError(
            "the picture is no depth picture", expected="16-bit grey, mm", got=f"mode {picture.mode}"
        )


def encode_depth(depth_mm: NDArray[np.uint16]) -> bytes:
    """A depth picture (H, W) uint16 mm as PNG bytes."""
    return encode_png(np.asarray(depth_mm, dtype="<u2"))


def to_mm(depth: ArrayLike, unit_m: float = 1.0) -> NDArray[np.uint16]:
    """Depths (...) in a unit as uint16 mm, 65535 for all beyond; 0 for what is no number above 0.5 mm."""
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.floor(np.asarray(depth, dtype=np.float64) * (1000.0 * unit_m) + 0.5)
    read = (rounded >= 1.0) & np.isfinite(rounded)
    return np.where(read, np.minimum(rounded, MAX_MM), 0.0).astype(np.uint16)


def to_m(depth_mm: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Depths (...) uint16 mm as float32 m; 0 stays 0."""
    return np.asarray(depth_mm.astype(np.float32) / np.float32(1000.0))


def in_range(depth_mm: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Which pixels (...) hold a distance that a depth camera can read."""
    return np.asarray((depth_mm >= NEAREST_MM) & (depth_mm <= FARTHEST_MM))


def resize_depth(depth_mm: NDArray[np.uint16], height: int, width: int) -> NDArray[np.uint16]:
    """A depth picture (H, W) in another size: the nearest reading of each cell, 0 where nothing is read."""
    # 0 wraps round to the largest number, and back again: one pass for what was read and what was not.
    less = np.asarray(depth_mm - 1, dtype=np.uint16)
    return np.asarray(_least(_least(less, 0, height), 1, width) + 1, dtype=np.uint16)


def _least(values: NDArray[np.uint16], axis: int, size: int) -> NDArray[np.uint16]:
    """The least value of each of ``size`` cells along an axis; the nearest value where there are more."""
    source = values.shape[axis]
    if size >= source:
        return np.asarray(np.take(values, (2 * np.arange(size) + 1) * source // (2 * size), axis=axis))
    return np.asarray(np.minimum.reduceat(values, np.arange(size) * source // size, axis=axis))


def check_size(height: int, width: int) -> None:
    """Refuse pictures that are too small or too large."""
    if not (MIN_SIDE <= width <= MAX_SIDE and MIN_SIDE <= height <= MAX_SIDE):
        raise ImageError(
            "the depth picture's size is out of range",
            expected=f"{MIN_SIDE} to {MAX_SIDE} pixels a side",
            got=f"{width} x {height}",
        )
