"""A closer look at a depth view: tests that take too long for every answer. NumPy alone.

The arm is the yardstick. It is rendered where ``state`` says that it stands and compared with the picture:
under the pose as told, under the usual mistakes (another frame, the inverse, another unit), and under a pose
that is fitted to the arm's readings.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ImageError
from cspace.world import CheckCancelled, Diagnosis, Finding, SuggestedPose
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import DepthCamera, in_range
from cspace.worlds.spatial.camera_info import OPTICAL_IN_BODY
from cspace.worlds.spatial.diagnostics import arm_in_picture, field_deg
from cspace.worlds.spatial.extrinsics import ArmMatch, arm_match, fit_pose, near_arm, turn_deg
from cspace.worlds.spatial.poses import pose_of
from cspace.worlds.spatial.sensor import DepthSensor
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.visibility import SLACK_M, reduced, self_filter

# Fewer pixels of the rendered arm say nothing.
_FEW_PIXELS = 60
# Of pixels that should show the arm, what is too little, and what is enough for another explanation.
_DISAGREES, _EXPLAINS, _BETTER = 0.5, 0.75, 0.25
# How far readings on the arm have to move by a pose that fits better, and to what share their distance to the
# arm falls. The arm's true surface moves those of a right pose by up to 1 cm, for spheres only cover it.
_OFF = ((0.011, 0.8), (0.007, 0.33))
# The arm has to be in view to that share as told.
_AS_MANY = 0.4
# Share of pixels that see through the arm, less a rim that spheres may stand out by.
_RIM_M, _SEEN_THROUGH = 0.01, 0.4
_BLANK_ARM, _BLANK_PICTURE = 0.6, 0.03
# A picture that reads nearly nothing beyond it is of a camera at the hand, or of another unit.
_NEAR_M = 0.25
# Beyond the filter's slack; more pixels of the picture than noise leaves there.
_LEFT_M, _LEFT_SHARE = 0.02, 0.0028
# A height, and the share of readings at it that is worth a note.
_LEVEL_M, _LEVEL_SHARE = 0.02, 0.2
# Readings of a camera that another one sees through by so much, and the share of them that is too much.
_THROUGH_M, _THROUGH_SHARE = 0.1, 0.25

# Poses that people send instead: what they are, what to do, and the right one.
_Turned = Callable[[NDArray[np.float64]], NDArray[np.float64]]
_WRONG_PLACE = "everything is seen in a wrong place"
_INSTEAD: dict[str, tuple[str, str, _Turned]] = {
    "inverted-pose": (
        "the pose is of the robot's base in the camera",
        "send the camera in the base, its inverse",
        lambda pose: np.asarray(np.linalg.inv(pose), dtype=np.float64),
    ),
    "body-frame": (
        "the pose is of the camera's body (x forward, y left, z up)",
        "send `frame` body beside it",
        lambda pose: pose @ OPTICAL_IN_BODY,
    ),
    "opengl-frame": (
        "the pose has y up and z backwards, as in OpenGL and Blender",
        "turn both axes round",
        lambda pose: pose @ np.diag([1.0, -1.0, -1.0, 1.0]),
    ),
    "upside-down": (
        "the picture is turned by 180 degrees against the pose",
        "turn either of them",
        lambda pose: pose @ np.diag([-1.0, -1.0, 1.0, 1.0]),
    ),
}
_SCALES = {"ten times": 0.1, "five times": 0.2, "four times": 0.25, "eight times": 0.125, "a tenth of": 10.0}


def nothing_in_reach(error: ImageError) -> Finding:
    """The finding of a view that is refused because nothing in reach is seen."""
    return Finding("nothing-in-reach", f"{error.what}: {error.got}", "it is refused", str(error.remedy))


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    """A picture as it is looked at: its number, depth (H, W) in m, 0 = no reading, and camera."""

    number: int
    depth_m: NDArray[np.float64]
    camera: DepthCamera


def diagnosed(
    arm: SerialArm,
    sensor: DepthSensor,
    view: DepthView,
    each: Sequence[NDArray[np.float64] | None],
    cheap: Sequence[Finding],
    check_cancelled: CheckCancelled,
) -> Diagnosis:
    """Looks closely at a view.

    Args:
        arm: that is planned for.
        sensor: with the cameras of training.
        view: as it came.
        each: (S, 4) of the arm at the state of each picture; None where that is not known.
        cheap: findings of :func:`cspace.worlds.spatial.diagnostics.diagnose`.
        check_cancelled: called between parts of some ms; what it raises passes through.
    """
    findings, shots = list(cheap), list[_Shot]()
    notes, poses = list[str](), list[SuggestedPose]()
    moved = len(set(view.states)) > 1
    for number, (picture, camera, spheres) in enumerate(zip(view.pictures, view.cameras, each, strict=True)):
        check_cancelled()
        smaller, own = reduced(np.where(in_range(picture), picture, np.uint16(0)), camera)
        shot = _Shot(number, _metres(smaller), own)
        notes.append(_described(shot, sensor))
        findings += _of_readings(shot)
        rest_m = shot.depth_m
        if spheres is None:
            where = (number,) if moved else ()
            findings += _of_base(shot, arm, where, check_cancelled)
        else:
            found = _of_arm(shot, arm, spheres, check_cancelled)
            findings += found.findings
            notes += found.notes
            poses += found.poses
            if found.poses and number in view.on_link:
                notes.append(
                    f"picture {number}: its camera is on a link; the suggested pose is in the base frame, by "
                    "where this picture's `state` puts the link"
                )
            rest_m = _metres(self_filter(smaller, own, spheres, check_cancelled=check_cancelled).depth_mm)
            if not found.findings:
                findings += _of_rest(shot, rest_m, arm, spheres, check_cancelled)
        notes += _of_level(replace(shot, depth_m=rest_m))
        # An arm that has moved is no reason why pictures should agree.
        shots.append(replace(shot, depth_m=rest_m) if moved else shot)
    findings += _of_pairs(shots, check_cancelled)
    return Diagnosis(tuple(_merged(findings)), tuple(notes), tuple(poses))


def _metres(depth_mm: NDArray[np.uint16]) -> NDArray[np.float64]:
    return np.asarray(depth_mm, dtype=np.float64) * 1e-3


def _merged(findings: Sequence[Finding]) -> Iterable[Finding]:
    """Each code once, with the pictures of all that have it."""
    for code in dict.fromkeys(one.code for one in findings):
        same = [one for one in findings if one.code == code]
        yield replace(same[0], pictures=tuple(sorted({n for one in same for n in one.pictures})))


def _described(shot: _Shot, sensor: DepthSensor) -> str:
    read = shot.depth_m[shot.depth_m > 0.0]
    low, high = sensor.views.field_deg
    return (
        f"picture {shot.number}: {len(read) / shot.depth_m.size:.0%} of the pixels read, half beyond "
        f"{np.median(read):.2f} m; {field_deg(shot.camera):.0f} degrees wide, trained {low:.0f} to {high:.0f}"
    )


def _of_readings(shot: _Shot) -> Iterable[Finding]:
    read = shot.depth_m[shot.depth_m > 0.0]
    share = len(read) / shot.depth_m.size
    if share < _BLANK_PICTURE:
        yield Finding(
            "blank",
            f"{share:.1%} of the pixels read something",
            "nearly all space counts as unseen",
            "look at the picture: the lens may be covered, or the scene too near, too dark or too bright",
            (shot.number,),
        )
    if np.percentile(read, 98) < _NEAR_M:
        yield Finding(
            "near-readings",
            f"nearly all readings are nearer than {np.percentile(read, 98):.2f} m",
            "if the unit is not mm, everything is seen in a wrong place",
            "check depth_scale_m; ignore this for a camera at the hand",
            (shot.number,),
        )


def _of_arm(
    shot: _Shot, arm: SerialArm, spheres: NDArray[np.float64], check_cancelled: CheckCancelled
) -> Diagnosis:
    stated = arm_match(shot.depth_m, shot.camera, spheres, check_cancelled)
    if stated.pixels < _FEW_PIXELS or stated.agree < _DISAGREES:
        instead = _instead(shot, spheres, stated, check_cancelled)
        if instead is not None:
            return instead
    fit = fit_pose(shot.depth_m, shot.camera, spheres, check_cancelled)
    if (
        fit is not None
        and any(fit.shift_m > shift_m and fit.after_m < closer * fit.before_m for shift_m, closer in _OFF)
        and fit.match.pixels >= _FEW_PIXELS
        # What slides the arm to where it was not in view fits something else.
        and fit.stated.rendered >= _AS_MANY * fit.match.rendered
        and fit.match.agree >= _EXPLAINS
        and fit.match.quality > fit.stated.quality
    ):
        return _off(shot, fit.camera, fit.before_m, fit.after_m)
    inner = np.column_stack([spheres[:, :3], np.maximum(spheres[:, 3] - _RIM_M, 1e-3)])
    moving = arm_match(shot.depth_m, shot.camera, inner[arm.sphere_links() > 1], check_cancelled)
    for match in (moving, stated):
        if match.pixels < _FEW_PIXELS or match.through < _SEEN_THROUGH:
            continue
        seen = f"{match.through:.0%} of the pixels that should show the arm see through it"
        remedy = "check that `state` is of the moment of the picture and in rad, and the camera's pose"
        effect = "the arm's readings count as obstacles, and what is behind it as the arm"
        return Diagnosis((Finding("arm-elsewhere", seen, effect, remedy, (shot.number,)),))
    if stated.rendered >= 2 * _FEW_PIXELS and stated.blank > _BLANK_ARM:
        seen = f"{stated.blank:.0%} of the pixels that should show the arm read nothing"
        remedy = "look at the picture: the arm may be too dark or shiny, or the lens covered"
        return Diagnosis((Finding("holes", seen, "surfaces are missed", remedy, (shot.number,)),))
    if stated.pixels < _FEW_PIXELS:
        return Diagnosis((), (f"picture {shot.number}: too little of the arm in view to test the pose",))
    noted = f"the arm is where `state` and the pose say, on {stated.agree:.0%} of {stated.pixels} pixels"
    return Diagnosis((), (f"picture {shot.number}: {noted}",))


def _instead(
    shot: _Shot, spheres: NDArray[np.float64], stated: ArmMatch, check_cancelled: CheckCancelled
) -> Diagnosis | None:
    """The usual mistake that explains where the arm is seen, if one does."""
    tried: list[tuple[float, Diagnosis]] = []
    for code, (what, remedy, turned) in _INSTEAD.items():
        camera = replace(shot.camera, pose=pose_of(turned(shot.camera.matrix)))
        found = arm_match(shot.depth_m, camera, spheres, check_cancelled)
        if _explains(found, stated):
            seen = f"{what}: so the arm is seen where it is on {found.agree:.0%} of its pixels"
            one = Finding(code, seen, _WRONG_PLACE, remedy, (shot.number,))
            tried.append((found.quality, Diagnosis((one,), (), (_suggested(shot, camera),))))
    for words, scale in _SCALES.items():
        found = arm_match(shot.depth_m * scale, shot.camera, spheres, check_cancelled)
        if _explains(found, stated):
            remedy = f"multiply depth_scale_m by {scale:g} (send {1e-3 * scale:g} if none was sent)"
            one = Finding(
                "depth-unit",
                f"the arm's pixels read {words} its distance",
                _WRONG_PLACE,
                remedy,
                (shot.number,),
            )
            tried.append((found.quality, Diagnosis((one,))))
    return max(tried, key=lambda one: one[0])[1] if tried else None


def _explains(found: ArmMatch, stated: ArmMatch) -> bool:
    enough = found.pixels >= max(2 * _FEW_PIXELS, 0.3 * found.rendered) and found.agree >= _EXPLAINS
    return enough and found.quality > stated.quality + _BETTER


def _off(shot: _Shot, camera: DepthCamera, before_m: float, after_m: float) -> Diagnosis:
    pose = _suggested(shot, camera)
    one = Finding(
        "extrinsics",
        f"the arm is seen {100 * pose.offset_m:.1f} cm and {pose.turn_deg:.1f} degrees off: its readings lie "
        f"{1e3 * before_m:.0f} mm from its surface, {1e3 * after_m:.0f} mm with another pose of the camera",
        "all surfaces are as far off, and parts of the arm may count as obstacles",
        "calibrate again or take the suggested pose; check that `state` is of the moment of the picture",
        (shot.number,),
    )
    return Diagnosis((one,), (), (pose,))


def _suggested(shot: _Shot, camera: DepthCamera) -> SuggestedPose:
    stated, found = shot.camera.matrix, camera.matrix
    return SuggestedPose(
        shot.number,
        camera.pose,
        float(np.linalg.norm(found[:3, 3] - stated[:3, 3])),
        turn_deg(found[:3, :3] @ stated[:3, :3].T),
    )


def _of_rest(
    shot: _Shot,
    rest_m: NDArray[np.float64],
    arm: SerialArm,
    spheres: NDArray[np.float64],
    check_cancelled: CheckCancelled,
) -> Iterable[Finding]:
    """Readings that the self filter leaves close round the arm's moving parts."""
    moving = spheres[arm.sphere_links() > 0]
    points = shot.camera.points_m(rest_m)[rest_m > 0.0]
    left = len(near_arm(points, moving, SLACK_M + _LEFT_M, check_cancelled))
    if left > max(15, _LEFT_SHARE * rest_m.size):
        yield Finding(
            "arm-pixels-left",
            f"{left} readings stay within {100 * (SLACK_M + _LEFT_M):.0f} cm of the arm beside its own",
            "they count as obstacles that touch the arm",
            "if nothing stands there, add what the arm carries to its description, or check `state` and pose",
            (shot.number,),
        )


def _of_base(
    shot: _Shot, arm: SerialArm, pictures: tuple[int, ...], check_cancelled: CheckCancelled
) -> Iterable[Finding]:
    """Whether the part of an arm that stands still is in a picture without ``state``."""
    still = arm.sphere_links() == 0
    match = arm_match(shot.depth_m, shot.camera, arm.spheres_at(np.zeros(arm.dim))[still], check_cancelled)
    if match.pixels >= _FEW_PIXELS / 3 and match.agree >= _EXPLAINS:
        seen = f"the arm's base is seen on {match.pixels} pixels, and no `state` was sent"
        yield arm_in_picture(seen, pictures)


def _of_pairs(shots: Sequence[_Shot], check_cancelled: CheckCancelled) -> Iterable[Finding]:
    """Pictures that see through what others show."""
    for one, other in permutations(shots, 2):
        check_cancelled()
        places = other.camera.project(one.camera.points_m(one.depth_m)[one.depth_m > 0.0])
        places = places[other.camera.shows(places)]
        columns, rows = np.rint(places[:, :2]).astype(int).T
        read = other.depth_m[rows, columns]
        gap = (read - places[:, 2])[read > 0.0]
        if len(gap) < 2 * _FEW_PIXELS or (share := float((gap > _THROUGH_M).mean())) < _THROUGH_SHARE:
            continue
        yield Finding(
            "cameras-disagree",
            f"picture {other.number} sees through {share:.0%} of the readings of picture {one.number}",
            "one of them is seen in a wrong place, or the scene has changed between them",
            "check the poses of both cameras, and that their pictures are of the same moment",
            (one.number, other.number),
        )


def _of_level(shot: _Shot) -> tuple[str, ...]:
    """Where most readings lie at one height, as on a table or a floor."""
    heights = shot.camera.points_m(shot.depth_m)[shot.depth_m > 0.0][:, 2]
    if len(heights) < _FEW_PIXELS:
        return ()
    counts, edges = np.histogram(heights, np.arange(heights.min(), heights.max() + 2 * _LEVEL_M, _LEVEL_M))
    fullest = int(np.argmax(counts))
    share = counts[fullest] / len(heights)
    if share < _LEVEL_SHARE:
        return ()
    height = float(np.median(heights[np.abs(heights - edges[fullest] - 0.5 * _LEVEL_M) < _LEVEL_M]))
    return (f"picture {shot.number}: {share:.0%} of the readings beside the arm lie at z = {height:.2f} m",)
