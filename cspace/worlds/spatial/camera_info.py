"""Cameras as people write them: pinhole numbers or ROS's CameraInfo, lens distortion, and poses."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ImageError, ScenarioError
from cspace.world import CheckCancelled
from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.depth_files import read_number
from cspace.worlds.spatial.poses import Pose, pose_of, read_pose

PINHOLE = ("fx", "fy", "cx", "cy")
_INFO = "camera_info"
_FRAMES = ("optical", "body")
# x right, y down, z forward in x forward, y left, z up: REP 103 of ROS.
OPTICAL_IN_BODY = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
# Coefficients of each model: k1, k2, p1, p2, k3, and in the second k4, k5, k6.
_COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8}
_MOST_COEFFICIENTS = 14
# Rows that are undistorted at once, in some ms.
_ROWS = 64
_REMEDY = "send the camera in the base frame: x right, y down, z forward, pixel centres at whole numbers"


def read_pinhole(values: object, shape: tuple[int, ...]) -> tuple[DepthCamera, tuple[float, ...]]:
    """The camera of a picture (H, W), of plain values, and the distortion of its lens.

    ``values``: ``fx, fy, cx, cy`` in pixels, or ``camera_info``, ROS's message as a mapping or as text in
    YAML or JSON; with ``pose``, and ``frame`` where the pose is of the camera's body. ``shape``: of the
    picture. Returns the camera without distortion, and the coefficients that :func:`undistorted` takes; none
    where the picture is as the camera's.
    """
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
    distortion: tuple[float, ...] = ()
    if _INFO in members:
        numbers, distortion = _of_info(members[_INFO], shape)
    else:
        numbers = {name: float(read_number(members[name], name)) for name in PINHOLE}
    try:
        camera = DepthCamera(**numbers, width=shape[1], height=shape[0], pose=camera_pose(members))
    except (ImageError, ScenarioError) as error:
        raise ImageError(
            error.what, expected=error.expected, got=error.got, remedy=error.remedy or _REMEDY
        ) from error
    return camera, distortion


def camera_pose(camera: Mapping[str, Any]) -> Pose:
    """Where the optical frame of a camera of plain values is, in the base.

    Its ``pose`` is as :func:`read_pose` takes it; its ``frame`` is ``optical``, which is the default, or
    ``body``.
    """
    pose, frame = read_pose(camera.get("pose"), "the camera", ImageError), camera.get("frame", _FRAMES[0])
    if frame not in _FRAMES:
        raise ImageError(
            "the camera's frame is unknown",
            expected="optical (x right, y down, z forward) or body (x forward, y left, z up)",
            got=repr(frame)[:200],
        )
    return pose if frame == _FRAMES[0] else pose_of(np.array(pose) @ OPTICAL_IN_BODY)


def _of_info(values: object, shape: tuple[int, ...]) -> tuple[dict[str, float], tuple[float, ...]]:
    """Pinhole numbers and distortion of a CameraInfo."""
    if isinstance(values, str):
        # Not every installation has YAML.
        from cspace.files import read_yaml  # noqa: PLC0415

        # As `ros2 topic echo` ends a message.
        values = read_yaml(values.rstrip().removesuffix("---"), _INFO, ImageError)
    # ROS 1 has K and D in its messages.
    info = {str(key).lower(): value for key, value in values.items()} if isinstance(values, Mapping) else {}
    # The file that camera_calibration and camera_info_manager write.
    for name, kept in (
        ("image_height", "height"),
        ("image_width", "width"),
        ("camera_matrix", "k"),
        ("distortion_coefficients", "d"),
    ):
        if name in info:
            value = info[name]
            info[kept] = value.get("data") if isinstance(value, Mapping) else value
    height, width = info.get("height"), info.get("width")
    if (height, width) != shape:
        raise _wrong_info(
            "is of another picture",
            f"height {shape[0]} and width {shape[1]}, as the picture",
            f"height {height!r} and width {width!r}",
            "send the CameraInfo of the depth topic, in the mode that the picture was taken in",
        )
    k, roi = info.get("k"), info.get("roi") or {}
    if not isinstance(k, list) or len(k) != 9:
        raise _wrong_info("has no k", "k with 9 numbers", repr(k))
    matrix = [float(read_number(one, "k")) for one in k]
    fx, skew, cx, zero, fy, cy, *last = matrix
    if skew or zero or last != [0.0, 0.0, 1.0]:
        raise _wrong_info("has another k", "fx 0 cx, 0 fy cy, 0 0 1", repr(matrix))
    cut = [info.get("binning_x", 0), info.get("binning_y", 0)]
    offsets = [roi.get("x_offset", 0), roi.get("y_offset", 0)] if isinstance(roi, Mapping) else [roi]
    if any(one not in (0, 1) for one in cut) or any(offsets):
        raise _wrong_info(
            "is of a larger picture",
            "no binning and no offset of a region of interest",
            f"binning {cut}, offsets {offsets}",
            "send k of the picture as it is: divided by the binning, cx and cy less the offset",
        )
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}, _distortion(info)


def _distortion(info: Mapping[str, Any]) -> tuple[float, ...]:
    given, model = info.get("d", []), info.get("distortion_model", "")
    if not isinstance(given, list) or len(given) > _MOST_COEFFICIENTS:
        raise _wrong_info("has no d", f"a list of at most {_MOST_COEFFICIENTS} coefficients", repr(given))
    d = tuple(float(read_number(one, "d")) for one in given)
    most = _COEFFICIENTS.get(model, 0) if isinstance(model, str) else 0
    # Without a model there is no distortion, while zeros of a fisheye's are one.
    if (not most and model not in ("", "none")) or any(d[most:]):
        raise _wrong_info(
            f"follows the distortion model {model!r}"[:100],
            " or ".join(f"{name} with {count} coefficients" for name, count in _COEFFICIENTS.items()),
            f"d {d}",
            "rectify the picture, and send the CameraInfo of the rectified one, with zeros as d",
        )
    return d[:most] if any(d) else ()


def _wrong_info(what: str, expected: str, got: str, remedy: str | None = None) -> ImageError:
    return ImageError(f"the camera info {what}", expected=expected, got=got[:200], remedy=remedy)


def undistorted(
    picture: NDArray[np.uint16],
    camera: DepthCamera,
    distortion: tuple[float, ...],
    check_cancelled: CheckCancelled = lambda: None,
) -> NDArray[np.uint16]:
    """The picture that the camera would take without its lens's distortion.

    Every pixel has the reading of the nearest pixel that its ray falls on, for depths are never averaged over
    edges; 0 where that lies beside the picture. Source: OpenCV, camera calibration and 3D reconstruction.

    ``picture``: (H, W), depth along the optical axis. ``camera``: of it. ``distortion``: k1, k2, p1, p2, k3,
    k4, k5, k6 as far as there are; none leaves the picture as it is. ``check_cancelled``: called between
    parts of some ms; what it raises passes through.
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
                raise _wrong_info(
                    "has a distortion that folds the picture over",
                    "coefficients of this picture's lens",
                    f"d {distortion}",
                    "check d, k and the picture's size",
                )
            columns = camera.fx * (x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)) + camera.cx
            rows = camera.fy * (y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y) + camera.cy
        columns, rows = np.floor(columns + 0.5), np.floor(rows + 0.5)
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        source = picture[
            np.where(inside, rows, 0).astype(np.intp), np.where(inside, columns, 0).astype(np.intp)
        ]
        found[top : top + len(y)] = np.where(inside, source, 0)
        check_cancelled()
    return found
