"""A closer look at a depth view: tests that take too long for every answer. NumPy alone.

The arm is the yardstick. It is rendered where ``state`` says that it stands and compared with the picture:
under the pose as told, under the usual mistakes (another frame, the inverse, another unit), and under a pose
that is fitted to the arm's readings.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ImageError
from cspace.world import POSE_CODES, CheckCancelled, Diagnosis, Finding, SuggestedPose
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import DepthCamera, in_range
from cspace.worlds.spatial.diagnostics import arm_in_picture, field_deg
from cspace.worlds.spatial.hypotheses import (
    FEW_PIXELS,
    FRAMES,
    HYPOTHESES,
    Explanation,
    Request,
    Score,
    best_of,
    explanations,
    moved,
    to_surface,
)
from cspace.worlds.spatial.poses import turn_deg
from cspace.worlds.spatial.sensor import DepthSensor
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.visibility import SLACK_M, reduced, self_filter

# How much better than the request as sent a hypothesis has to be, and how well it has to fit.
_BETTER, _FITS, _LEAST = 0.06, 0.5, 0.25
_BASE_AGREES = 0.75
# Of the pixels that read something, the score of an arm that is where it should be; a turned camera with
# so much more shows that it is not.
_AGREES, _MOST, _CLEARLY, _TURNS_RAD = 0.5, 0.7, 0.4, np.radians((-11.0, -6.0, 6.0, 11.0))
# Two within this of each other tie.
_TIE = 0.02
# Above this share of pixels that see through it the arm is elsewhere; below this agreement, too, unless all
# that disagrees is nearer and may hide it.
_SEEN_THROUGH, _DISAGREES, _NOT_HIDDEN = 0.4, 0.35, 0.1
# Of the pixels that other hypotheses would see.
_BLANK_ARM, _BLANK_PICTURE = 0.6, 0.03
# A picture that reads nearly nothing beyond it is of a camera at the hand, or of another unit.
_NEAR_M = 0.25
# Beyond the filter's slack; more pixels of the picture than noise leaves there.
_LEFT_M, _LEFT_SHARE = 0.02, 0.0028
# A height, and the share of readings at it that is worth a note.
_LEVEL_M, _LEVEL_SHARE = 0.02, 0.2
# Readings of a camera that another one sees through by so much, and the share of them that is too much.
_THROUGH_M, _THROUGH_SHARE = 0.1, 0.25
_WRONG_PLACE = "everything is seen in a wrong place"
_POSES = {"quaternion-order", "inverted-pose", "body-frame", "opengl-frame", "transposed-rotation",
          "translation-unit", "upside-down", "base-height", "extrinsics"}  # fmt: skip
ELSEWHERE, NOT_IN_VIEW = "arm-elsewhere", "arm-not-in-view"


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
    cheap: Sequence[Finding],
    check_cancelled: CheckCancelled,
) -> Diagnosis:
    """Looks closely at a view; ``cheap`` are the warnings that other answers carry."""
    findings, shots = [one for one in cheap if one.code not in (POSE_CODES | {NOT_IN_VIEW})], list[_Shot]()
    notes, poses = list[str](), list[SuggestedPose]()
    is_moving = len(set(view.states)) > 1
    for number, (picture, camera, state) in enumerate(
        zip(view.pictures, view.cameras, view.states, strict=True)
    ):
        check_cancelled()
        smaller, own = reduced(np.where(in_range(picture), picture, np.uint16(0)), camera)
        shot = _Shot(number, _metres(smaller), own)
        notes.append(_described(shot, sensor))
        findings += _of_readings(shot)
        rest_m = shot.depth_m
        if state is None:
            findings += _of_base(shot, arm, (number,) if is_moving else ())
        elif arm.sphere_count:
            units, own = reduced(picture, camera)
            found = _of_arm(Request(arm, units.astype(float), own, state), number, check_cancelled)
            findings += found.findings
            notes += found.notes
            poses += found.poses
            if found.poses and number in view.on_link:
                notes.append(
                    f"picture {number}: its camera is on a link; the suggested pose is in the base frame, by "
                    "where this picture's `state` puts the link"
                )
            spheres = arm.spheres_at(state)
            rest_m = _metres(self_filter(smaller, own, spheres, check_cancelled=check_cancelled).depth_mm)
            if not found.findings:
                findings += _of_rest(shot, rest_m, arm, spheres)
        notes += _of_level(replace(shot, depth_m=rest_m))
        # An arm that has moved is no reason why pictures should agree.
        shots.append(replace(shot, depth_m=rest_m) if is_moving else shot)
    findings += _of_pairs(shots, check_cancelled)
    return Diagnosis(tuple(_merged(findings)), tuple(notes), tuple(poses))


def pose_findings(arm: SerialArm, view: DepthView) -> tuple[Finding, ...]:
    """Whether the arm is where ``state`` puts it, by some hundred pixels: the cheap part of the diagnosis."""
    findings = list[Finding]()
    for number, (picture, camera, state) in enumerate(
        zip(view.pictures, view.cameras, view.states, strict=True)
    ):
        if state is None or not arm.sphere_count:
            continue
        one = Request(arm, picture.astype(float), camera, state).coarse()
        stated = one.score(FEW_COARSE)
        if stated.pixels >= FEW_COARSE and stated.arm >= _AGREES * (1.0 - stated.blank):
            continue
        explained = explanations(one, stated, FRAMES, lambda: None)
        best = _named(sorted(explained, key=lambda other: -other.score.total), stated, 2 * _BETTER)
        is_elsewhere = _is_elsewhere(stated, FEW_COARSE) or _fits_turned(one, stated)
        findings += [_finding(other, stated, number) for other in best] or _unexplained(
            stated, number, is_elsewhere, FEW_COARSE
        )
    return tuple(_merged(findings))


# Pixels of the reduced picture.
FEW_COARSE = 12


def _fits_turned(one: Request, stated: Score) -> bool:
    """Whether a camera that is turned a little sees the arm clearly better, and most of it."""
    turned = (
        moved(one, np.append(np.zeros(3), axis)) for axis in np.outer(_TURNS_RAD, np.eye(3)).reshape(-1, 3)
    )
    found = best_of(one, turned).score(FEW_COARSE)
    is_seen = found.pixels >= FEW_COARSE and found.arm >= _MOST * (1.0 - found.blank)
    return is_seen and found.total > stated.total + _CLEARLY


def _is_elsewhere(stated: Score, few: int = FEW_PIXELS) -> bool:
    disagrees = stated.agree < _DISAGREES and stated.through >= _NOT_HIDDEN
    return stated.pixels >= few and (stated.through >= _SEEN_THROUGH or disagrees)


def _named(found: Sequence[Explanation], stated: Score, better: float = _BETTER) -> list[Explanation]:
    """What is clearly better than the request as sent: the best, and one that ties with it."""
    good = [
        one
        for one in found
        if one.score.arm >= max(_FITS * (1.0 - one.score.blank), _LEAST)
        and one.score.total > stated.total + better
    ]
    return [one for one in good[:2] if one.score.total > good[0].score.total - _TIE]


def _finding(one: Explanation, stated: Score, number: int) -> Finding:
    seen = f"{one.what} (score {one.score.total:.2f}, as sent {stated.total:.2f})"
    return Finding(one.code, seen, _WRONG_PLACE, one.remedy, (number,))


def _unexplained(stated: Score, number: int, is_elsewhere: bool, few: int = FEW_PIXELS) -> list[Finding]:
    """What is said of an arm that is not where it should be, if no hypothesis is better."""
    share = stated.pixels / max(stated.rendered, 1)
    if is_elsewhere:
        seen = (
            f"of the pixels that should show the arm {stated.agree * share:.0%} read it and "
            f"{stated.through * share:.0%} see through it, and no "
            f"single cause explains where it is (score as sent {stated.total:.2f})"
        )
        remedy = (
            "check that `state` is of the moment of the picture and in rad, and the camera's pose and numbers"
        )
        effect = "the arm's readings count as obstacles, and what is behind it as the arm"
        return [Finding(ELSEWHERE, seen, effect, remedy, (number,))]
    if stated.rendered < few // 3:
        seen = "almost none of the arm is in view by `state` and the camera's pose"
        remedy = (
            "check the pose: x right, y down, z forward, quaternion as x, y, z, w; "
            "ignore this if it looks past the arm"
        )
        return [
            Finding(NOT_IN_VIEW, seen, "if the arm is in the picture, " + _WRONG_PLACE, remedy, (number,))
        ]
    return []


def _of_arm(one: Request, number: int, check_cancelled: CheckCancelled) -> Diagnosis:
    stated = one.score()
    found = sorted(
        explanations(one, stated, HYPOTHESES, check_cancelled), key=lambda other: -other.score.total
    )
    scores = ", ".join(f"{other.code} {other.score.total:.2f}" for other in found[:3])
    note = f"picture {number}: score as sent {stated.total:.2f}; best {scores}"
    named = _named(found, stated)
    findings = [_finding(other, stated, number) for other in named] or _unexplained(
        stated, number, _is_elsewhere(stated)
    )
    poses = [
        _suggested(number, one.camera, other)
        for other in named
        # The arm alone would also move a right camera to a wrong state.
        if other.code in _POSES
        and other.score.base >= stated.base
        and other.score.level >= stated.level - _TIE
    ][:1]
    if not findings and stated.rendered >= 2 * FEW_PIXELS and stated.blank > _BLANK_ARM:
        seen = f"{stated.blank:.0%} of the pixels that should show the arm read nothing"
        remedy = "look at the picture: the arm may be too dark or shiny, or the lens covered"
        findings = [Finding("holes", seen, "surfaces are missed", remedy, (number,))]
    if not findings:
        agrees = f"the arm is where `state` and the pose say, on {stated.agree:.0%} of {stated.pixels} pixels"
        note = f"picture {number}: {agrees}" if stated.pixels else note
    return Diagnosis(tuple(findings), (note,), tuple(poses))


def _suggested(number: int, stated: DepthCamera, found: Explanation) -> SuggestedPose:
    was, now = stated.matrix, found.meant.camera.matrix
    offset_m = float(np.linalg.norm(now[:3, 3] - was[:3, 3]))
    return SuggestedPose(number, found.meant.camera.pose, offset_m, turn_deg(now[:3, :3] @ was[:3, :3].T))


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


def _of_rest(
    shot: _Shot, rest_m: NDArray[np.float64], arm: SerialArm, spheres: NDArray[np.float64]
) -> Iterable[Finding]:
    """Readings that the self filter leaves close round the arm's moving parts."""
    moving = spheres[arm.sphere_links() > 0]
    points = shot.camera.points_m(rest_m)[rest_m > 0.0]
    left = int((to_surface(points, moving) < SLACK_M + _LEFT_M).sum()) if len(moving) else 0
    if left > max(15, _LEFT_SHARE * rest_m.size):
        yield Finding(
            "arm-pixels-left",
            f"{left} readings stay within {100 * (SLACK_M + _LEFT_M):.0f} cm of the arm beside its own",
            "they count as obstacles that touch the arm",
            "if nothing stands there, add what the arm carries to its description, or check `state` and pose",
            (shot.number,),
        )


def _of_base(shot: _Shot, arm: SerialArm, pictures: tuple[int, ...]) -> Iterable[Finding]:
    """Whether the part of an arm that stands still is in a picture without ``state``."""
    still = replace(arm, parts=tuple(part for part in arm.parts if part.link == 0), touching=())
    if not still.parts:
        return
    match = Request(still, shot.depth_m, shot.camera, (0.0,) * arm.dim, 1.0).score()
    if match.pixels >= FEW_PIXELS / 3 and match.agree >= _BASE_AGREES:
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
        if len(gap) < 2 * FEW_PIXELS or (share := float((gap > _THROUGH_M).mean())) < _THROUGH_SHARE:
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
    if len(heights) < FEW_PIXELS:
        return ()
    counts, edges = np.histogram(heights, np.arange(heights.min(), heights.max() + 2 * _LEVEL_M, _LEVEL_M))
    fullest = int(np.argmax(counts))
    share = counts[fullest] / len(heights)
    if share < _LEVEL_SHARE:
        return ()
    height = float(np.median(heights[np.abs(heights - edges[fullest] - 0.5 * _LEVEL_M) < _LEVEL_M]))
    return (f"picture {shot.number}: {share:.0%} of the readings beside the arm lie at z = {height:.2f} m",)
