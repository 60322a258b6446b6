"""What depth cameras saw of a scene, as a view file or as arrays. NumPy alone."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ImageError, ScenarioError
from cspace.space import NEAR_LIMIT_RAD, JointSpace
from cspace.view_file import View, check_counts, pack_view, unstamped
from cspace.world import CheckCancelled
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import (
    FARTHEST_MM,
    NEAREST_MM,
    DepthCamera,
    encode_depth,
    in_range,
)
from cspace.worlds.spatial.camera_info import PINHOLE, camera_pose, read_pinhole, undistorted
from cspace.worlds.spatial.depth_files import read_depth, read_number
from cspace.worlds.spatial.planning_scene import PlanningScene, read_planning_scene

State = tuple[float, ...]
# Of all pictures, or of each; None where the arm is in none.
States = State | tuple[State | None, ...] | None


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """Depth pictures of one scene.

    Args:
        pictures: one to four, (H, W) uint16 mm along the optical axis, 0 = no reading.
        state: (d,) rad, where the arm was when they were taken; None where it is in no picture; or one or the
            other for each picture.
        on_link: numbers of the pictures whose cameras came with a pose in the frame of a link; here it is in
            the base's.
        known: of the scene beside the pictures; None without anything.
    """

    pictures: tuple[NDArray[np.uint16], ...]
    cameras: tuple[DepthCamera, ...]
    state: States = None
    on_link: tuple[int, ...] = ()
    known: PlanningScene | None = None

    @property
    def states(self) -> tuple[State | None, ...]:
        """The state of each picture."""
        return _for_each(self.state, len(self.pictures))

    def __post_init__(self) -> None:
        check_counts(len(self.pictures), len(self.cameras))
        _for_each(self.state, len(self.pictures))
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
    known = None if view.known is None else json.dumps(view.known.to_dict()).encode()
    return pack_view([encode_depth(picture) for picture in view.pictures], cameras, view.state, known=known)


def read_view(data: bytes | View, arm: SerialArm, check_cancelled: CheckCancelled | None = None) -> DepthView:
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
    check_cancelled = check_cancelled or (lambda: None)
    pictures, cameras = [], []
    for one in file.pictures:
        pictures.append(read_depth(one, file.depth_scale_m, check_cancelled))
        check_cancelled()
    state = state_of(file.state, len(pictures), arm.space)
    given = unstamped(file.cameras)[0]
    for number, values in enumerate(cameras_in_base(given, state, arm)):
        camera, distortion = read_pinhole(values, pictures[number].shape)
        pictures[number] = undistorted(pictures[number], camera, distortion, check_cancelled)
        cameras.append(camera)
    on_link = tuple(number for number, values in enumerate(given) if _is_on_link(values))
    return DepthView(tuple(pictures), tuple(cameras), state, on_link, known)


_LINK = "link"
_UNIT = (
    "a 16-bit picture is in mm, one of floats in metres: send depth_scale_m for another unit (0.001 for mm, "
    "0.0001 for tenths, 0.0002 for TUM RGB-D)"
)


def cameras_in_base(cameras: Sequence[object], state: States, arm: SerialArm) -> list[object]:
    """Cameras of plain values, those on a link with the pose of their optical frame in the base.

    Args:
        cameras: one for each picture; ``link`` names a frame of the arm (:meth:`SerialArm.frame_of`) that
            ``pose`` is in.
    """
    states = _for_each(state, len(cameras))
    return [_in_base(*one, arm) for one in zip(range(len(cameras)), cameras, states, strict=True)]


def _is_on_link(camera: object) -> bool:
    return isinstance(camera, Mapping) and _LINK in camera


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
            expected=f"one for all, or a list of {pictures}: one, or null, for each picture",
            got=f"{len(state)} states",
        )
    return cast("tuple[State | None, ...]", state)


def state_of(values: object, pictures: int, space: JointSpace) -> States:
    """Where an arm was, of plain values; None where they are.

    Args:
        values: a configuration for all pictures, or a list with one, or None, for each.
    """
    if isinstance(values, list | tuple) and any(
        one is None or isinstance(one, list | tuple) for one in values
    ):
        return _for_each(tuple(_configuration(one, space) for one in values), pictures)
    return _configuration(values, space)


def _configuration(values: object, space: JointSpace) -> State | None:
    if values is None:
        return None
    fits = isinstance(values, list | tuple) and len(values) == space.dim
    angles = [float(read_number(one, "state")) for one in values] if fits else []  # type: ignore[attr-defined]
    if not fits:
        raise ImageError(
            "the state does not fit the robot",
            expected=f"{space.dim} angles in rad within its limits",
            got=repr(values)[:200],
            remedy="send where the arm was when the pictures were taken, or leave it out if it is in none",
        )
    # An arm may stand a little beyond its limits, and there its pixels are.
    space.admitted(angles, "the state does not fit the robot", ImageError, NEAR_LIMIT_RAD)
    return tuple(angles)


def _camera_values(camera: DepthCamera) -> dict[str, Any]:
    return {name: value for name, value in camera.to_dict().items() if name in (*PINHOLE, "pose")}
