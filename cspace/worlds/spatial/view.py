"""What depth cameras saw of a scene, as a view file or as arrays. NumPy alone."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ImageError
from cspace.space import JointSpace
from cspace.view_file import MAX_PICTURES, check_counts, pack_view, unpack_view
from cspace.world import Arrays, CheckCancelled, TensorInput
from cspace.worlds.spatial.camera import (
    FARTHEST_MM,
    NEAREST_MM,
    DepthCamera,
    encode_depth,
    in_range,
)
from cspace.worlds.spatial.camera_info import PINHOLE, read_pinhole, undistorted
from cspace.worlds.spatial.depth_files import in_mm, pixels_in, read_depth, read_number
from cspace.worlds.spatial.planning_scene import PlanningScene, read_planning_scene


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """Depth pictures of one scene.

    Args:
        pictures: one to four, (H, W) uint16 mm along the optical axis, 0 = no reading.
        cameras: one each.
        state: (d,) rad, where the arm was when they were taken; None where it is in no picture.
        known: of the scene beside the pictures; None without anything.

    Raises:
        ImageError: there are too few or too many pictures, not a camera each, one does not fit its camera, or
            none has a reading.
    """

    pictures: tuple[NDArray[np.uint16], ...]
    cameras: tuple[DepthCamera, ...]
    state: tuple[float, ...] | None = None
    known: PlanningScene | None = None

    def __post_init__(self) -> None:
        check_counts(len(self.pictures), len(self.cameras))
        for picture, camera in zip(self.pictures, self.cameras, strict=True):
            if picture.shape != camera.picture_shape or picture.dtype != np.uint16:
                raise ImageError(
                    "the depth picture does not fit its camera",
                    expected=f"uint16 of {camera.width} x {camera.height} pixels",
                    got=f"{picture.dtype} of shape {picture.shape}",
                )
            if not in_range(picture).any():
                read = picture[picture > 0]
                raise ImageError(
                    "a depth picture has no reading",
                    expected=f"distances of {NEAREST_MM} to {FARTHEST_MM} mm, 0 where there is none",
                    got=f"{read.min()} to {read.max()} mm" if read.size else "zeros alone",
                    remedy=_UNIT if read.size else "leave the picture out, or look at the camera's driver",
                )


def write_view(view: DepthView) -> bytes:
    """The view file of a view."""
    cameras = [_camera_values(camera) for camera in view.cameras]
    state = None if view.state is None else list(view.state)
    return pack_view([encode_depth(picture) for picture in view.pictures], cameras, state)


def pixels_of(data: bytes) -> int:
    """How many pixels the pictures of an untrusted view file say that they have.

    Raises:
        ImageError: it is none, or a picture is none.
    """
    return sum(pixels_in(one) for one in unpack_view(data).pictures)


def read_view(data: bytes, space: JointSpace, check_cancelled: CheckCancelled | None = None) -> DepthView:
    """An untrusted view file.

    Args:
        data: the file.
        space: of the arm.
        check_cancelled: called after each picture; what it raises passes through.

    Raises:
        ImageError: it is none, a picture or a camera is none, they do not fit each other, no picture has a
            reading, or the state lies outside of the arm's limits.
        InputError: what is known does not fit.
    """
    file = unpack_view(data)
    check_cancelled = check_cancelled or (lambda: None)
    pictures, cameras = [], []
    for one in file.pictures:
        pictures.append(read_depth(one, file.depth_scale_m, check_cancelled))
        check_cancelled()
    for number, values in enumerate(file.cameras):
        camera, distortion = read_pinhole(values, pictures[number].shape)
        pictures[number] = undistorted(pictures[number], camera, distortion, check_cancelled)
        cameras.append(camera)
    known = None if file.known is None else read_planning_scene(file.known)
    return DepthView(tuple(pictures), tuple(cameras), state_of(file.state, space), known)


_UNIT = (
    "a 16-bit picture is in mm, one of floats in metres: send depth_scale_m for another unit (0.001 for mm, "
    "0.0001 for tenths, 0.0002 for TUM RGB-D)"
)


def state_of(values: object, space: JointSpace) -> tuple[float, ...] | None:
    """Where an arm was, of plain values; None where they are.

    Raises:
        ImageError: that is outside of its limits, or no configuration.
    """
    if values is None:
        return None
    fits = isinstance(values, list) and len(values) == space.dim
    angles = [float(read_number(one, "state")) for one in values] if fits else []  # type: ignore[attr-defined]
    if not fits:
        raise ImageError(
            "the state does not fit the robot",
            expected=f"{space.dim} angles in rad within its limits",
            got=repr(values)[:200],
            remedy="send where the arm was when the pictures were taken, or leave it out if it is in none",
        )
    return tuple(space.admitted(angles, "the state does not fit the robot", ImageError).tolist())


def _camera_values(camera: DepthCamera) -> dict[str, Any]:
    return {name: value for name, value in camera.to_dict().items() if name in (*PINHOLE, "pose")}


DEPTH, INTRINSICS, POSES, STATE, SCALE = "depth", "intrinsics", "poses", "state", "depth_scale_m"


def view_tensors(dim: int) -> tuple[TensorInput, ...]:
    """Pictures, cameras and the arm's state.

    Pictures of one size; of each camera fx, fy, cx and cy, pixels, and its pose in the base frame, m; where
    the arm was, rad, absent where it is in no picture; metres per unit of the pictures, absent for mm.
    """
    return (
        TensorInput(DEPTH, "uint16", ("c", "h", "w"), MAX_PICTURES),
        TensorInput(INTRINSICS, "float64", ("c", len(PINHOLE)), MAX_PICTURES),
        TensorInput(POSES, "float64", ("c", 4, 4), MAX_PICTURES),
        TensorInput(STATE, "float64", (dim,), optional=True),
        TensorInput(SCALE, "float64", (1,), optional=True),
    )


def view_of_tensors(tensors: Arrays, space: JointSpace) -> DepthView:
    """The view of arrays that follow :func:`view_tensors`.

    Raises:
        ImageError: a picture, a camera or the state is none.
    """
    scale = tensors[SCALE].tolist()[0] if SCALE in tensors else None
    pictures = tuple(in_mm(np.ascontiguousarray(one, dtype=np.uint16), scale) for one in tensors[DEPTH])
    rows = zip(tensors[INTRINSICS].tolist(), tensors[POSES].tolist(), pictures, strict=True)
    cameras = tuple(
        read_pinhole({**dict(zip(PINHOLE, numbers, strict=True)), "pose": pose}, picture.shape)[0]
        for numbers, pose, picture in rows
    )
    state = tensors[STATE].tolist() if STATE in tensors else None
    return DepthView(pictures, cameras, state_of(state, space))
