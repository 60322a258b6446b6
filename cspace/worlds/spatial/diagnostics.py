"""What is wrong, or may be, with the depth pictures of a request: findings that answers carry as warnings."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ImageError
from cspace.world import ARM_IN_PICTURE, CAUSES, LITTLE_IN_REACH, Finding, Image
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import FARTHEST_MM, NEAREST_MM, DepthCamera, in_range
from cspace.worlds.spatial.sensor import (
    DISTANCE_STEP_M,
    FREE,
    CameraViews,
    DepthSensor,
    GridBox,
    shoulder_reach_m,
)
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.visibility import lookup

# Of 500 pictures of training scenes, one shows less than this share of the reachable space.
LITTLE_SEEN = 0.001
# Fewer voxels at surfaces are noise.
_FEW_VOXELS = 5
# Of the picture's side, from its middle; real lenses stay within 0.05.
_OFF_CENTRE = 0.15
# Of focal lengths; square pixels come within 0.02.
_FOCAL_RATIO = 1.1
_LOST_SHARE = 0.01
# What a pixel covers where the arm stands; of training pictures less than 0.025 m.
_COARSE_M = 0.04
# Units that other cameras and data sets write, m: tenths of mm, TUM RGB-D, SR300, L515.
_UNITS_M = (0.0001, 0.000125, 0.0002, 0.00025)
# Of the spheres that can tell, at least so many and such a share have a surface inside.
_ARM_SPHERES, _ARM_SHARE = 3, 0.15
# Lower parts of the base may touch the table that it stands on.
_ABOVE_TABLE_M = 0.02
_ROUNDING_M = 0.005
# Of many configurations. Where the arm's pixels are obstacles nearly all of them are held to collide; of
# uniform ones in usual scenes at most half, of those drawn by a model at most 0.88.
_MOST_COLLIDE = 0.9
# Of a camera; training has at most 8. Where it looks nearly straight down there is no upright.
_ROLLED_DEG, _LEVEL = 60.0, 0.35
# Sine of the angle above the horizon.
_LOOKS_UP = 0.5
# Spheres that cover the arm stand out so far.
_INSIDE_M = 0.01
_FIELD_SLACK_DEG = 8.0
# From the arm, beyond the distance to what is looked at.
_FARTHER_M = 1.0
_STATE = "send `state`, the joints' angles when the pictures were taken, and the arm's pixels are dropped"


@dataclass(frozen=True, slots=True, eq=False)
class _Reach:
    """The part of a grid that an arm can reach.

    Args:
        voxels: (X, Y, Z), which ones.
        surface: codes of the distance below it are of voxels with a surface about their centres.
    """

    voxels: NDArray[np.bool_]
    surface: np.uint8

    def at_surface(self, image: Image) -> NDArray[np.bool_]:
        """Which voxels of an array (X, Y, Z, 2) are in reach and have a surface about their centres."""
        return np.asarray((image[..., 0] < self.surface) & self.voxels)

    def seen(self, image: Image) -> NDArray[np.bool_]:
        """Which are in reach and seen: free, or at a surface."""
        return np.asarray(((image[..., 1] == FREE) | (image[..., 0] < self.surface)) & self.voxels)

    def seen_share(self, image: Image) -> float:
        """Of all that are in reach."""
        return float(self.seen(image).sum() / max(int(self.voxels.sum()), 1))


def diagnose(
    arm: SerialArm,
    sensor: DepthSensor,
    view: DepthView,
    single: Sequence[Image],
    fused: Image,
    posed: Sequence[Finding] = (),
) -> tuple[Finding, ...]:
    """The findings of a view.

    Args:
        arm: that is planned for.
        sensor: with the grid of the arrays, and the cameras of training.
        view: as it came.
        single: what each picture says alone, (X, Y, Z, 2) each.
        fused: what all say together.
        posed: what is wrong with the pose by the arm in the picture, which an error then names.

    Raises:
        ImageError: no picture shows any of the space that the arm can reach.
    """
    grid = sensor.grid
    reach = _reach(arm, grid)
    blind = _numbers(not reach.seen(one).any() for one in single)
    if len(blind) == len(single):
        raise ImageError(
            "the camera sees none of the space that the arm can reach"
            if len(single) == 1
            else "the cameras see none of the space that the arm can reach",
            expected="free space or surfaces within "
            f"{shoulder_reach_m(arm):.2f} m of the arm's first joint in at least one picture",
            got=_looks(view),
            remedy="; ".join(f"{one.seen}: {one.remedy}" for one in posed if one.code in CAUSES)
            or "check that pose is the camera in the robot's base with z forward, x right and y down "
            "(OpenGL and Blender have z backwards), and that depths are in mm, or send depth_scale_m",
        )
    found = [
        *_of_reach(reach, view, blind, fused),
        *view_findings(arm, sensor, view),
    ]
    lacking = _numbers(state is None for state in view.states)
    if lacking and _base_is_solid(arm, grid, np.minimum.reduce([single[number] for number in lacking])):
        seen = "surfaces stand inside the arm's own base, and no `state` was sent"
        found.append(arm_in_picture(seen, lacking if len(lacking) < len(single) else ()))
    return tuple(found)


def unseen_m(arm: SerialArm, grid: GridBox, image: Image) -> NDArray[np.float64]:
    """(N, 3): centres of the voxels in reach that are not seen, free or at a surface, m in the base frame."""
    reach = _reach(arm, grid)
    return grid.centres_m()[reach.voxels & ~reach.seen(image)]


def view_findings(arm: SerialArm, sensor: DepthSensor, view: DepthView) -> tuple[Finding, ...]:
    """Those of cameras, readings and state alone, whatever is seen."""
    shoulder_m = np.asarray(arm.joints[0].origin.xyz_m)
    return (
        *_of_cameras(view.cameras, shoulder_m),
        *_of_readings(view),
        *_of_poses(arm, view),
        *_of_training(sensor.views, view.cameras, shoulder_m),
    )


def arm_in_picture(seen: str, pictures: tuple[int, ...] = ()) -> Finding:
    """The finding of an arm in pictures without ``state``; by what it was seen."""
    effect = "the arm's pixels count as obstacles, so that configurations near it are held to collide"
    return Finding(ARM_IN_PICTURE, seen, effect, _STATE, pictures)


def least_novelty(arm: SerialArm, grid: GridBox, image: Image) -> float:
    """How novel a picture (X, Y, Z, 2) is at least: 1 where nothing in reach is seen, 0 from a little on."""
    reach = _reach(arm, grid)
    return max(0.0, 1.0 - reach.seen_share(image) / LITTLE_SEEN)


def start_findings(arm: SerialArm, grid: GridBox, image: Image, start: ArrayLike) -> tuple[Finding, ...]:
    """Of a picture without `state`: whether the arm seems to stand in it where a plan starts, (d,) rad."""
    moving = arm.sphere_links() > 0
    centres = arm.sphere_centres_m([np.asarray(start, dtype=np.float64)])[0][moving]
    if not _are_solid(grid, image, centres, arm.spheres_m()[moving, 3]):
        return ()
    seen = "surfaces stand inside the arm at the start, and no `state` was sent"
    effect = "the arm's pixels count as obstacles away from the start, and may hide every path"
    return (Finding(ARM_IN_PICTURE, seen, effect, _STATE),)


def colliding_findings(share: float) -> tuple[Finding, ...]:
    """Of a picture without `state`: whether most of many configurations are held to collide."""
    if share < _MOST_COLLIDE:
        return ()
    seen = f"{share:.0%} of the configurations are held to collide, and no `state` was sent"
    effect = "if the arm is in a picture, its pixels count as obstacles"
    return (Finding("most-collide", seen, effect, _STATE),)


def _of_reach(reach: _Reach, view: DepthView, blind: tuple[int, ...], fused: Image) -> Iterable[Finding]:
    if blind:
        yield Finding(
            "nothing-in-reach",
            "a picture shows none of the space that the arm can reach",
            "it adds nothing to the answer",
            "check this camera's pose, and the unit of its depths",
            blind,
        )
    share = reach.seen_share(fused)
    if share < LITTLE_SEEN:
        yield Finding(
            LITTLE_IN_REACH,
            f"the pictures show {100 * share:.2g} % of the space that the arm can reach",
            "nearly all of the answer is what the model has learned of other scenes, and novelty is raised",
            "check the camera's pose and the unit of the depths, or add a picture from elsewhere",
        )
    if np.count_nonzero(reach.at_surface(fused)) < _FEW_VOXELS:
        yield Finding(
            "no-surface-in-reach",
            "no depth that was read lies in the space that the arm can reach",
            "all space that is seen counts as free",
            _unit_remedy(view),
        )


def _of_cameras(cameras: Sequence[DepthCamera], shoulder_m: NDArray[np.float64]) -> Iterable[Finding]:
    off = _numbers(_off_centre(one) > _OFF_CENTRE for one in cameras)
    if off:
        one = cameras[off[0]]
        yield Finding(
            "principal-point",
            f"the principal point ({one.cx:g}, {one.cy:g}) lies far from the middle of a picture of "
            f"{one.width} x {one.height} pixels",
            "if the camera's numbers are of another resolution, everything is seen in a wrong place",
            "send fx, fy, cx and cy of this picture's size; ignore this for a picture that was cut out",
            off,
        )
    uneven = _numbers(not 1.0 / _FOCAL_RATIO <= one.fx / one.fy <= _FOCAL_RATIO for one in cameras)
    if uneven:
        one = cameras[uneven[0]]
        yield Finding(
            "focal-lengths",
            f"the focal lengths disagree: fx {one.fx:g} and fy {one.fy:g} pixels",
            "if the pixels are square, everything is seen in a wrong place",
            "check fx and fy; ignore this for a picture that was squeezed along one side",
            uneven,
        )

    wide = [float(np.linalg.norm(one.matrix[:3, 3] - shoulder_m)) / min(one.fx, one.fy) for one in cameras]
    coarse = _numbers(metres > _COARSE_M for metres in wide)
    if coarse:
        yield Finding(
            "coarse-picture",
            f"a pixel covers {100 * max(wide):.0f} cm where the arm stands",
            "what is smaller is missed, and the space about it counts as free",
            "send the picture in its full size, with the camera's numbers of that size",
            coarse,
        )


def _of_readings(view: DepthView) -> Iterable[Finding]:
    lost = [_lost_share(one) for one in view.pictures]
    where = _numbers(share > _LOST_SHARE for share in lost)
    if where:
        yield Finding(
            "out-of-range",
            f"{max(lost):.0%} of the pixels read nearer than {NEAREST_MM} mm or farther than "
            f"{FARTHEST_MM // 1000} m, as no depth camera does",
            "they count as no reading, and the space before them as unseen",
            "send 0 where there is no reading, and depth_scale_m where the unit is not mm",
            where,
        )


def _of_poses(arm: SerialArm, view: DepthView) -> Iterable[Finding]:
    rolls = [_roll_deg(one) for one in view.cameras]
    rolled = _numbers(abs(deg) > _ROLLED_DEG for deg in rolls)
    if rolled:
        yield Finding(
            "rolled",
            f"by its pose the camera is turned by {rolls[rolled[0]]:.0f} degrees about its optical axis, "
            f"{'on its head' if abs(rolls[rolled[0]]) > 135.0 else 'on its side'}",
            "if it hangs upright, everything is seen in a wrong place",
            "check that the pose is of the optical frame (x right, y down, z forward) in the robot's base, "
            "not the inverse, and that no driver turns the picture; ignore this for a camera mounted so",
            rolled,
        )
    up = _numbers(one.matrix[2, 2] > _LOOKS_UP for one in view.cameras)
    if up:
        yield Finding(
            "looks-up",
            f"by its pose the camera looks {np.degrees(np.arcsin(view.cameras[up[0]].matrix[2, 2])):.0f} "
            "degrees up",
            "it sees little of what the arm works on, or everything is seen in a wrong place",
            "check that z of the pose is the optical axis: a body frame has z up (send frame body for it)",
            up,
        )
    if not arm.sphere_count:
        return
    depths = [
        -np.inf if state is None else _depth_m(arm.spheres_at(state), one.matrix[:3, 3])
        for one, state in zip(view.cameras, view.states, strict=True)
    ]
    inside = _numbers(depth_m > _INSIDE_M for depth_m in depths)
    if inside:
        yield Finding(
            "camera-inside-arm",
            f"by its pose the camera is {100 * max(depths):.0f} cm inside the arm as it stands at `state`",
            "all that it reads counts as the arm's and is dropped, or everything is seen in a wrong place",
            "send the pose of the camera, not that of the link that it is mounted on",
            inside,
        )


def _of_training(
    views: CameraViews, cameras: Sequence[DepthCamera], shoulder_m: NDArray[np.float64]
) -> Iterable[Finding]:
    fields = [field_deg(one) for one in cameras]
    low, high = views.field_deg[0] - _FIELD_SLACK_DEG, views.field_deg[1] + _FIELD_SLACK_DEG
    other = _numbers(not low <= deg <= high for deg in fields)
    if other:
        yield Finding(
            "field-of-view",
            f"the picture is {fields[other[0]]:.0f} degrees wide, those of training "
            f"{views.field_deg[0]:.0f} to {views.field_deg[1]:.0f}",
            "the model knows no such camera; if the numbers are wrong, everything is seen in a wrong place",
            "check fx against the picture's width, or train for this camera",
            other,
        )
    away = [float(np.linalg.norm(one.matrix[:3, 3] - shoulder_m)) for one in cameras]
    most = views.distance_m[1] + _FARTHER_M
    far = _numbers(metres > most for metres in away)
    if far:
        yield Finding(
            "far-camera",
            f"the camera stands {max(away):.1f} m from the arm, those of training at most {most:.1f} m",
            "the model knows no such view",
            "check the unit of the pose (metres), or train for this camera",
            far,
        )


def field_deg(camera: DepthCamera) -> float:
    """How wide a camera's pictures are, degrees."""
    return float(np.degrees(2.0 * np.arctan(0.5 * camera.width / camera.fx)))


def _numbers(holds: Iterable[bool | np.bool_]) -> tuple[int, ...]:
    """Of the pictures that something holds for."""
    return tuple(number for number, one in enumerate(holds) if one)


def _depth_m(spheres: NDArray[np.float64], place_m: NDArray[np.float64]) -> float:
    """How deep a place (3,) lies in spheres (S, 4), below 0 outside of all."""
    return float((spheres[:, 3] - np.linalg.norm(spheres[:, :3] - place_m, axis=1)).max())


def _roll_deg(camera: DepthCamera) -> float:
    """How far a camera is turned about its optical axis, -180 to 180; 0 where it looks up or down."""
    right_up, down_up = camera.matrix[2, 0], camera.matrix[2, 1]
    if np.hypot(right_up, down_up) < _LEVEL:
        return 0.0
    return float(np.degrees(np.arctan2(right_up, -down_up)))


def _off_centre(camera: DepthCamera) -> float:
    """How far the principal point is from the picture's middle, in sides."""
    across = abs(camera.cx - (camera.width - 1) / 2.0) / camera.width
    return max(across, abs(camera.cy - (camera.height - 1) / 2.0) / camera.height)


def _lost_share(depth_mm: NDArray[np.uint16]) -> float:
    return float(((depth_mm > 0) & ~in_range(depth_mm)).mean())


def _looks(view: DepthView) -> str:
    """Where the cameras are, where they look, and how far they read, for an error."""
    lines = []
    for picture, camera in zip(view.pictures, view.cameras, strict=True):
        pose, read = camera.matrix, picture[in_range(picture)]
        place, ahead = (", ".join(f"{one:.2f}" for one in pose[:3, column]) for column in (3, 2))
        lines.append(f"a camera at ({place}) m that looks along ({ahead}) and reads {np.median(read):.0f} mm")
    return "; ".join(lines)


def _unit_remedy(view: DepthView) -> str:
    """The unit in which depths would be as far as arms reach, where there is one."""
    read = np.concatenate([picture[picture > 0] for picture in view.pictures])
    middle_m = float(np.median(read)) * 1e-3
    fitting = [unit for unit in _UNITS_M if 0.5 <= middle_m * unit * 1e3 <= 1.5]
    if middle_m < 3.0 or not fitting:
        return "nothing to do if the space is empty; else check the camera's pose"
    return (
        f"half of the pixels read {middle_m:.1f} m or more: if the unit is not mm, send depth_scale_m "
        f"({' or '.join(f'{unit:g}' for unit in fitting)})"
    )


def _base_is_solid(arm: SerialArm, grid: GridBox, image: Image) -> bool:
    """Whether surfaces stand in the part of the arm that no joint moves, or turns about itself."""
    spheres, links = arm.spheres_m(), arm.sphere_links()
    first = arm.joints[0]
    along = spheres[:, :3] @ np.asarray(first.axis, dtype=np.float64)
    off_axis = np.linalg.norm(spheres[:, :3] - along[:, None] * np.asarray(first.axis), axis=1)
    centres = arm.sphere_centres_m([np.zeros(arm.dim)])[0]
    still = (links == 0) | ((links == 1) & (off_axis < 0.5 * spheres[:, 3]))
    # What touches the lowest parts may be the table.
    held = still & (centres[:, 2] - spheres[:, 3] > _ABOVE_TABLE_M)
    return _are_solid(grid, image, centres[held], spheres[held, 3])


def _are_solid(
    grid: GridBox, image: Image, centres_m: NDArray[np.float64], radii_m: NDArray[np.float64]
) -> bool:
    """Whether surfaces stand in so many of the spheres (S, 3) and (S,) as in an arm that is seen."""
    if not len(radii_m):
        return False
    hits = lookup(image, grid, centres_m).distance_m < radii_m - _ROUNDING_M
    return bool(hits.sum() >= min(_ARM_SPHERES, len(hits)) and hits.mean() >= _ARM_SHARE)


@lru_cache(maxsize=16)
def _reach(arm: SerialArm, grid: GridBox) -> _Reach:
    away = np.linalg.norm(grid.centres_m() - np.asarray(arm.joints[0].origin.xyz_m), axis=-1)
    surface = np.uint8(np.ceil(0.5 * grid.voxel_m / DISTANCE_STEP_M))
    return _Reach(away <= shoulder_reach_m(arm), surface)
