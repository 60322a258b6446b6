"""What depth cameras saw of a scene, as arrays, and of untrusted view files and pictures. NumPy alone."""

import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cspace.errors import ImageError, ScenarioError
from cspace.files import read_npy, read_object
from cspace.space import NEAR_LIMIT_RAD, JointSpace
from cspace.view_file import View, check_counts, pack_view, unstamped
from cspace.world import CheckCancelled
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import (
    FARTHEST_MM,
    MAX_SCALE_M,
    MIN_SCALE_M,
    NEAREST_MM,
    PINHOLE,
    DepthCamera,
    camera_pose,
    check_size,
    decode_depth,
    encode_depth,
    in_range,
    read_number,
    read_pinhole,
    to_mm,
    undistorted,
)
from cspace.worlds.spatial.planning_scene import PlanningScene, read_planning_scene

State = tuple[float, ...]
# Of all pictures, or of each; None where the arm is in none.
States = State | tuple[State | None, ...] | None


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """Depth pictures of one scene."""

    pictures: tuple[NDArray[np.uint16], ...]  # 1 to 4, (H, W) mm along the optical axis, 0 = no reading
    cameras: tuple[DepthCamera, ...]
    state: States = None  # (d,) rad, of all pictures or of each; None where the arm is in none
    on_link: tuple[int, ...] = ()  # of which pictures the cameras came with a pose in a link's frame
    known: PlanningScene | None = None  # of the scene beside the pictures; None without anything

    @property
    def states(self) -> tuple[State | None, ...]:
        return _for_each(self.state, len(self.pictures))

    def __post_init__(self) -> None:
        for picture in self.pictures:
            if not in_range(picture).any():
                read = picture[picture > 0]
                raise ImageError(
                    "a depth picture has no reading",
                    expected=f"distances of {NEAREST_MM} to {FARTHEST_MM} mm, 0 where there is none",
                    got=f"{read.min()} to {read.max()} mm" if read.size else "zeros alone",
                    remedy=_UNIT if read.size else "leave the picture out, or look at the camera's driver",
                )


def write_view(view: DepthView) -> bytes:
    """The view file of a view's pictures, cameras and state."""
    cameras = [{name: one.to_dict()[name] for name in (*PINHOLE, "pose")} for one in view.cameras]
    return pack_view([encode_depth(picture) for picture in view.pictures], cameras, view.state)


def read_view(
    data: bytes | View, arm: SerialArm, check_cancelled: CheckCancelled = lambda: None
) -> DepthView:
    """Decodes and checks untrusted pictures, each once."""
    file = View.of(data)
    if not file.cameras:
        raise ImageError(
            "the picture comes without its camera",
            expected="camera for each image: fx, fy, cx, cy and pose, 4 x 4, camera in base",
            got="a picture alone",
            remedy="send a camera beside each picture, in the same order",
        )
    check_counts(len(file.pictures), len(file.cameras))
    known = None if file.known is None else read_planning_scene(file.known)
    pictures, cameras = [], []
    for one in file.pictures:
        pictures.append(read_depth(one, file.depth_scale_m))
        check_cancelled()
    state = state_of(file.state, len(pictures), arm.space)
    given = unstamped(file.cameras)[0]
    for number, values in enumerate(cameras_in_base(given, state, arm)):
        camera, distortion = read_pinhole(values, pictures[number].shape)
        pictures[number] = undistorted(pictures[number], camera, distortion)
        cameras.append(camera)
        check_cancelled()
    on_link = tuple(at for at, values in enumerate(given) if isinstance(values, Mapping) and _LINK in values)
    return DepthView(tuple(pictures), tuple(cameras), state, on_link, known)


_LINK = "link"
_UNIT = (
    "a 16-bit picture is in mm, one of floats in metres: send depth_scale_m for another unit (0.001 for mm, "
    "0.0001 for tenths, 0.0002 for TUM RGB-D)"
)


def cameras_in_base(cameras: Sequence[object], state: States, arm: SerialArm) -> list[object]:
    """Cameras of plain values; one whose ``link`` names a frame of the arm gets its pose in the base."""
    states = _for_each(state, len(cameras))
    return [_in_base(*one, arm) for one in zip(range(len(cameras)), cameras, states, strict=True)]


def _in_base(number: int, camera: object, state: State | None, arm: SerialArm) -> object:
    if not isinstance(camera, Mapping) or _LINK not in camera:
        return camera
    link = camera[_LINK]
    if not isinstance(link, str) or state is None:
        raise ImageError(
            f"the camera of picture {number} is on a link, and it is not known where that is",
            expected="link, a name, and state, where the arm was when this picture was taken",
            got=f"link {link!r}"[:200] + (" without a state" if state is None else ""),
            remedy="send state, or one for each picture; leave link out for a pose in the base",
        )
    try:
        pose = arm.frame_of(link, state) @ np.array(camera_pose(camera))
    except ScenarioError as error:
        raise ImageError(error.what, expected=error.expected, got=error.got, remedy=error.remedy) from error
    kept = {name: value for name, value in camera.items() if name not in (_LINK, "frame")}
    return kept | {"pose": pose.tolist()}


def _for_each(state: States, pictures: int) -> tuple[State | None, ...]:
    if state is None or not any(one is None or isinstance(one, tuple) for one in state):
        return (cast("State | None", state),) * pictures
    if len(state) != pictures:
        raise ImageError(
            "the states do not fit the pictures",
            expected=f"one for all, or a list of {pictures}",
            got=f"{len(state)} states",
        )
    return cast("tuple[State | None, ...]", state)


def state_of(values: object, pictures: int, space: JointSpace) -> States:
    """Where an arm was, of plain values: a configuration for all pictures, or one or None for each."""
    what = "the state does not fit the robot"
    found: States = read_object(cast("type[States]", States), values, "the state", ImageError)
    for one in _for_each(found, pictures):
        if one is not None and len(one) != space.dim:
            raise ImageError(
                what,
                expected=f"{space.dim} angles in rad within its limits",
                got=repr(one)[:200],
                remedy="send where the arm was when the pictures were taken; leave it out if it is in none",
            )
        if one is not None:
            # An arm may stand a little beyond its limits, and there its pixels are.
            space.admitted(one, what, ImageError, NEAR_LIMIT_RAD)
    return found


_PNG, _NPY = b"\x89PNG", b"\x93NUMPY"
_BYTE_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_MOST_FIELDS, _MOST_VALUES = 64, 8192


def read_depth(data: bytes, depth_scale_m: object = None) -> NDArray[np.uint16]:
    """An untrusted depth picture as (H, W) uint16, mm along the optical axis, 0 where there is no reading.

    ``data``: a 16-bit PNG, or float32 as TIFF or ``.npy``. ``depth_scale_m``: metres per unit; None for mm in
    a PNG and metres in floats.
    """
    scale_m = None if depth_scale_m is None else _read_scale(depth_scale_m)
    if data.startswith(_PNG):
        units = decode_depth(data)
        return units if scale_m is None else to_mm(units, scale_m)
    depth = _read_npy(data) if data.startswith(_NPY) else _read_tiff(data)
    return to_mm(depth, 1.0 if scale_m is None else scale_m)


def _read_scale(depth_scale_m: object) -> float:
    scale = read_number(depth_scale_m, "depth_scale_m")
    if not MIN_SCALE_M <= scale <= MAX_SCALE_M:
        raise ImageError(
            "depth_scale_m does not fit",
            expected=f"metres per unit of the depth pictures, {MIN_SCALE_M:g} to {MAX_SCALE_M:g}",
            got=repr(scale)[:100],
            remedy="send 0.001 for millimetres, 0.0001 for tenths, 0.0002 for TUM RGB-D, 1 for metres",
        )
    return scale


def _read_npy(data: bytes) -> NDArray[np.float32]:
    try:
        depth = read_npy(data, ("<f4",), 2)
    except Exception as error:
        # All, for there is no list of what evaluating a header raises.
        raise _no_depth(".npy file", str(error)) from error
    check_size(*depth.shape)
    return depth


def _read_tiff(data: bytes) -> NDArray[np.float32]:
    try:
        _check_fields(data)
        with Image.open(io.BytesIO(data), formats=["TIFF"]) as picture:
            check_size(picture.height, picture.width)
            if picture.mode == "F":
                return np.array(picture)
            mode = picture.mode
    except ImageError:
        raise
    except Exception as error:
        # All, for there is no list of what a decoder raises for bytes from outside.
        raise _no_depth("file", str(error)) from error
    raise _no_depth("TIFF", f"a picture of mode {mode}")


def _check_fields(data: bytes) -> None:
    """Refuse what Pillow would read before it knows the size: 8 MiB can name 400 GB of values."""
    order = _BYTE_ORDERS[data[:4]]
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    values = [struct.unpack_from(f"{order}I", data, at + 6 + 12 * field)[0] for field in range(count)]
    (following,) = struct.unpack_from(f"{order}I", data, at + 2 + 12 * count)
    if count > _MOST_FIELDS or max(values, default=0) > _MOST_VALUES or following:
        raise _no_depth(
            "TIFF", f"{count} fields of up to {max(values, default=0)} values, or several pictures"
        )


def _no_depth(kind: str, got: str) -> ImageError:
    return ImageError(
        f"the {kind} is no depth picture",
        expected="float32 of shape (H, W), metres along the optical axis, or mm as a 16-bit PNG",
        got=got[:200],
        remedy="write depth_m.astype(np.float32) by np.save, Pillow, OpenCV or tifffile",
    )
