"""Warnings about depth pictures in every answer, and their diagnosis in seconds, by the arm as rendered."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ImageError
from cspace.world import (
    ARM_IN_PICTURE,
    CAUSES,
    LITTLE_IN_REACH,
    POSE_CODES,
    CheckCancelled,
    Diagnosis,
    Finding,
    Image,
    SuggestedPose,
)
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import FARTHEST_MM, NEAREST_MM, DepthCamera, in_range
from cspace.worlds.spatial.hypotheses import (
    BETTER,
    EVERY,
    FEW_PIXELS,
    FRAMES,
    TIE,
    Explanation,
    Request,
    Score,
    clearly_better,
    explanations,
    fits_turned,
    to_surface,
)
from cspace.worlds.spatial.poses import turn_deg
from cspace.worlds.spatial.sensor import (
    DISTANCE_STEP_M,
    FREE,
    CameraViews,
    DepthSensor,
    GridBox,
    shoulder_reach_m,
)
from cspace.worlds.spatial.view import DepthView, State
from cspace.worlds.spatial.visibility import SLACK_M, lookup, reduced, self_filter

# Of 500 pictures of training scenes, one shows less than this share of the reachable space.
LITTLE_SEEN = 0.001
_FEW_VOXELS = 5  # at surfaces; fewer are noise
_OFF_CENTRE = 0.15  # of the picture's side, from its middle; real lenses stay within 0.05
_FOCAL_RATIO = 1.1  # square pixels come within 1.02
_LOST_SHARE = 0.01
_COARSE_M = 0.04  # what a pixel covers where the arm stands; of training pictures less than 0.025 m
# Of the spheres that can tell, at least so many and such a share have a surface inside.
_ARM_SPHERES, _ARM_SHARE, _ROUNDING_M = 3, 0.15, 0.005
_ABOVE_TABLE_M = 0.02  # lower parts of the base may touch the table that it stands on
# Of many configurations. Where the arm's pixels are obstacles nearly all of them are held to collide; of
# uniform ones in usual scenes at most half, of those drawn by a model at most 0.88.
_MOST_COLLIDE = 0.9
# Training has at most 8 degrees. Where a camera looks nearly straight down there is no upright.
_ROLLED_DEG, _LEVEL = 60.0, 0.35
_LOOKS_UP = 0.5  # sine of the angle above the horizon
_INSIDE_M = 0.01  # by which spheres that cover the arm stand out
# Beyond the cameras of training: degrees of the field of view, and m from the arm.
_FIELD_SLACK_DEG, _FARTHER_M = 8.0, 1.0
# Of the pixels that read something, the score of an arm that is where it should be.
_AGREES = 0.5
# Above this share of pixels that see through it the arm is elsewhere; below this agreement, too, unless all
# that disagrees is nearer and may hide it.
_SEEN_THROUGH, _DISAGREES, _NOT_HIDDEN = 0.4, 0.35, 0.1
# Shares of pixels that read nothing of the arm, and of those that read something in the whole picture.
_BLANK_ARM, _BLANK_PICTURE = 0.6, 0.03
# A picture that reads nearly nothing beyond it is of a camera at the hand, or of another unit.
_NEAR_M = 0.25
# Readings so far beyond the filter's slack, and more of them than noise leaves there.
_LEFT_M, _LEFT_SHARE = 0.02, 0.0028
# Readings of a camera that another one sees through by so much, and the share of them that is too much.
_THROUGH_M, _THROUGH_SHARE = 0.1, 0.25
_FEW_COARSE = 12  # pixels of the reduced picture that is looked at for every answer
# Causes that another pose mends.
_POSES = (CAUSES - {"depth-unit"}) | {"base-height", "extrinsics"}
ELSEWHERE, NOT_IN_VIEW = "arm-elsewhere", "arm-not-in-view"
_WRONG_PLACE = "everything is seen in a wrong place"
_STATE = "send `state`, the joints' angles when the pictures were taken, and the arm's pixels are dropped"

# Of a finding about one picture: code, what is seen, its effect, and a remedy.
_Words = tuple[str, str, str, str]


def picture_findings(
    arm: SerialArm,
    sensor: DepthSensor,
    view: DepthView,
    single: Sequence[Image],
    fused: Image,
    posed: Sequence[Finding] = (),
) -> Iterator[Finding]:
    """The findings of a view, without those of the arm's place, which the error of a blind view names.

    ``single``: what each picture says alone, (X, Y, Z, 2) each; ``fused``: what all say together.
    """
    grid = sensor.grid
    blind = tuple(number for number, one in enumerate(single) if not _seen(arm, grid, one).any())
    if len(blind) == len(single):
        cameras = "the camera sees" if len(single) == 1 else "the cameras see"
        raise ImageError(
            f"{cameras} none of the space that the arm can reach",
            expected="free space or surfaces within "
            f"{shoulder_reach_m(arm):.2f} m of the arm's first joint in at least one picture",
            got="; ".join(
                "a camera at {} m that looks along {}".format(*np.round(one.matrix[:3, (3, 2)].T, 2).tolist())
                for one in view.cameras
            ),
            remedy="; ".join(f"{one.seen}: {one.remedy}" for one in posed if one.code in CAUSES)
            or "check that pose is the camera in the robot's base with z forward, x right and y down "
            "(OpenGL and Blender have z backwards), and that depths are in mm, or send depth_scale_m",
        )
    if blind:
        seen = "a picture shows none of the space that the arm can reach"
        remedy = "check this camera's pose, and the unit of its depths"
        yield Finding("nothing-in-reach", seen, "it adds nothing to the answer", remedy, blind)
    if (share := _seen_share(arm, grid, fused)) < LITTLE_SEEN:
        seen = f"the pictures show {100 * share:.2g} % of the space that the arm can reach"
        effect = (
            "nearly all of the answer is what the model has learned of other scenes, and novelty is raised"
        )
        remedy = "check the camera's pose and the unit of the depths, or add a picture from elsewhere"
        yield Finding(LITTLE_IN_REACH, seen, effect, remedy)
    if np.count_nonzero(_at_surface(grid, fused) & _reach(arm, grid)) < _FEW_VOXELS:
        seen = "no depth that was read lies in the space that the arm can reach"
        remedy = (
            "check the camera's pose, and send depth_scale_m if the unit is not mm; ignore an empty space"
        )
        yield Finding("no-surface-in-reach", seen, "all space that is seen counts as free", remedy)
    yield from view_findings(arm, sensor, view)
    lacking = tuple(number for number, state in enumerate(view.states) if state is None)
    if lacking and _base_is_solid(arm, grid, np.minimum.reduce([single[number] for number in lacking])):
        seen = "surfaces stand inside the arm's own base, and no `state` was sent"
        effect = "the arm's pixels count as obstacles, so that configurations near it are held to collide"
        pictures = lacking if len(lacking) < len(single) else ()
        yield Finding(ARM_IN_PICTURE, seen, effect, _STATE, pictures)


def view_findings(arm: SerialArm, sensor: DepthSensor, view: DepthView) -> tuple[Finding, ...]:
    """Those of cameras, readings and state alone, whatever is seen."""
    pictures = zip(view.pictures, view.cameras, view.states, strict=True)
    return _merged(
        Finding(*words, (number,))
        for number, (picture, camera, state) in enumerate(pictures)
        for words in (
            *_of_camera(arm, sensor.views, camera),
            *_of_picture(arm, picture, camera, state),
        )
    )


def least_novelty(arm: SerialArm, grid: GridBox, image: Image) -> float:
    """How novel a picture (X, Y, Z, 2) is at least: 1 where nothing in reach is seen, 0 from a little on."""
    return max(0.0, 1.0 - _seen_share(arm, grid, image) / LITTLE_SEEN)


def state_findings(
    arm: SerialArm, grid: GridBox, image: Image | None, start: ArrayLike | None, colliding: float
) -> Iterator[Finding]:
    """Of a picture without `state`, in which the arm may stand where a plan starts, (d,) rad.

    ``colliding``: the share of many configurations that are held to collide.
    """
    if colliding >= _MOST_COLLIDE:
        seen = f"{colliding:.0%} of the configurations are held to collide, and no `state` was sent"
        effect = "if the arm is in a picture, its pixels count as obstacles"
        yield Finding("most-collide", seen, effect, _STATE)
    if image is None or start is None:
        return
    if _are_solid(grid, image, arm.spheres_at(start)[arm.sphere_links() > 0]):
        seen = "surfaces stand inside the arm at the start, and no `state` was sent"
        effect = "the arm's pixels count as obstacles away from the start, and may hide every path"
        yield Finding(ARM_IN_PICTURE, seen, effect, _STATE)


@lru_cache(maxsize=16)
def _reach(arm: SerialArm, grid: GridBox) -> NDArray[np.bool_]:
    """Which voxels (X, Y, Z) the arm can reach."""
    away = np.linalg.norm(grid.centres_m() - np.asarray(arm.joints[0].origin.xyz_m), axis=-1)
    return np.asarray(away <= shoulder_reach_m(arm))


def _at_surface(grid: GridBox, image: Image) -> NDArray[np.bool_]:
    """Which voxels of an array (X, Y, Z, 2) have a surface about their centres."""
    return np.asarray(image[..., 0] < np.uint8(np.ceil(0.5 * grid.voxel_m / DISTANCE_STEP_M)))


def _seen(arm: SerialArm, grid: GridBox, image: Image) -> NDArray[np.bool_]:
    """Which voxels are in reach and seen: free, or at a surface."""
    return np.asarray(((image[..., 1] == FREE) | _at_surface(grid, image)) & _reach(arm, grid))


def _seen_share(arm: SerialArm, grid: GridBox, image: Image) -> float:
    """Of all that are in reach."""
    return float(_seen(arm, grid, image).sum() / max(int(_reach(arm, grid).sum()), 1))


def _of_camera(arm: SerialArm, views: CameraViews, camera: DepthCamera) -> Iterator[_Words]:
    centre, size = np.array((camera.cx, camera.cy)), np.array((camera.width, camera.height))
    if (np.abs(centre - (size - 1) / 2.0) / size).max() > _OFF_CENTRE:
        yield (
            "principal-point",
            f"({camera.cx:g}, {camera.cy:g}) is far from the middle of {camera.width} x {camera.height}",
            f"if the camera's numbers are of another resolution, {_WRONG_PLACE}",
            "send fx, fy, cx and cy of this picture's size; ignore this for a picture that was cut out",
        )
    if not 1.0 / _FOCAL_RATIO <= camera.fx / camera.fy <= _FOCAL_RATIO:
        yield (
            "focal-lengths",
            f"the focal lengths disagree: fx {camera.fx:g} and fy {camera.fy:g} pixels",
            f"if the pixels are square, {_WRONG_PLACE}",
            "check fx and fy; ignore this for a picture that was squeezed along one side",
        )
    away_m = float(np.linalg.norm(camera.matrix[:3, 3] - arm.joints[0].origin.xyz_m))
    if (pixel_m := away_m / min(camera.fx, camera.fy)) > _COARSE_M:
        yield (
            "coarse-picture",
            f"a pixel covers {100 * pixel_m:.0f} cm where the arm stands",
            "what is smaller is missed, and the space about it counts as free",
            "send the picture in its full size, with the camera's numbers of that size",
        )
    right_up, down_up, ahead_up = camera.matrix[2, :3]
    roll_deg = float(np.degrees(np.arctan2(right_up, -down_up)))
    if np.hypot(right_up, down_up) >= _LEVEL and abs(roll_deg) > _ROLLED_DEG:
        yield (
            "rolled",
            f"by its pose the camera is turned by {roll_deg:.0f} degrees about its optical axis",
            f"if it hangs upright, {_WRONG_PLACE}",
            "check that it is of the optical frame (x right, y down) in the base; ignore a camera mounted so",
        )
    if ahead_up > _LOOKS_UP:
        yield (
            "looks-up",
            f"by its pose the camera looks {np.degrees(np.arcsin(ahead_up)):.0f} degrees up",
            f"it sees little of what the arm works on, or {_WRONG_PLACE}",
            "check that z of the pose is the optical axis: a body frame has z up (send frame body for it)",
        )
    (low, high), deg = views.field_deg, _field_deg(camera)
    if not low - _FIELD_SLACK_DEG <= deg <= high + _FIELD_SLACK_DEG:
        yield (
            "field-of-view",
            f"the picture is {deg:.0f} degrees wide, those of training {low:.0f} to {high:.0f}",
            f"the model knows no such camera; if the numbers are wrong, {_WRONG_PLACE}",
            "check fx against the picture's width, or train for this camera",
        )
    if away_m > (most := views.distance_m[1] + _FARTHER_M):
        yield (
            "far-camera",
            f"the camera stands {away_m:.1f} m from the arm, those of training at most {most:.1f} m",
            "the model knows no such view",
            "check the unit of the pose (metres), or train for this camera",
        )


def _of_picture(
    arm: SerialArm, picture: NDArray[np.uint16], camera: DepthCamera, state: State | None
) -> Iterator[_Words]:
    if (lost := float(((picture > 0) & ~in_range(picture)).mean())) > _LOST_SHARE:
        yield (
            "out-of-range",
            f"{lost:.0%} of the pixels read nearer than {NEAREST_MM} or farther than {FARTHEST_MM} mm",
            "they count as no reading, and the space before them as unseen",
            "send 0 where there is no reading, and depth_scale_m where the unit is not mm",
        )
    if state is None or not arm.sphere_count:
        return
    if (inside_m := -float(to_surface(camera.matrix[None, :3, 3], arm.spheres_at(state))[0])) > _INSIDE_M:
        yield (
            "camera-inside-arm",
            f"by its pose the camera is {100 * inside_m:.0f} cm inside the arm as it stands at `state`",
            f"all that it reads counts as the arm's and is dropped, or {_WRONG_PLACE}",
            "send the pose of the camera, not that of the link that it is mounted on",
        )


def _field_deg(camera: DepthCamera) -> float:
    """How wide a camera's pictures are."""
    return float(np.degrees(2.0 * np.arctan(0.5 * camera.width / camera.fx)))


def _base_is_solid(arm: SerialArm, grid: GridBox, image: Image) -> bool:
    """Whether surfaces stand in the part of the arm that no joint moves, or turns about itself."""
    own, links, axis = arm.spheres_m(), arm.sphere_links(), np.asarray(arm.joints[0].axis)
    off_axis = np.linalg.norm(np.cross(own[:, :3], axis), axis=1)
    still = (links == 0) | ((links == 1) & (off_axis < 0.5 * own[:, 3]))
    spheres = arm.spheres_at(np.zeros(arm.dim))
    # What touches the lowest parts may be the table.
    return _are_solid(grid, image, spheres[still & (spheres[:, 2] - spheres[:, 3] > _ABOVE_TABLE_M)])


def _are_solid(grid: GridBox, image: Image, spheres: NDArray[np.float64]) -> bool:
    """Whether surfaces stand in so many of the spheres (S, 4) as in an arm that is seen."""
    if not len(spheres):
        return False
    hits = lookup(image, grid, spheres[:, :3]).distance_m < spheres[:, 3] - _ROUNDING_M
    return bool(hits.sum() >= min(_ARM_SPHERES, len(hits)) and hits.mean() >= _ARM_SHARE)


def _merged(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Each code once, with the pictures of all that have it."""
    found = dict[str, Finding]()
    for one in findings:
        first = found.setdefault(one.code, one)
        found[one.code] = replace(first, pictures=tuple(sorted({*first.pictures, *one.pictures})))
    return tuple(found.values())


def pose_findings(arm: SerialArm, view: DepthView) -> tuple[Finding, ...]:
    """Whether the arm is where ``state`` puts it, by some hundred pixels."""
    findings = list[Finding]()
    pictures = zip(view.pictures, view.cameras, view.states, strict=True)
    for number, (picture, camera, state) in enumerate(pictures):
        if state is None or not arm.sphere_count:
            continue
        one = Request(arm, picture.astype(float), camera, state).coarse()
        stated = one.score(_FEW_COARSE)
        if stated.pixels >= _FEW_COARSE and stated.arm >= _AGREES * (1.0 - stated.blank):
            continue
        explained = explanations(one, stated, FRAMES, lambda: None)
        findings += [
            _finding(other, stated, number) for other in clearly_better(explained, stated, 2 * BETTER)
        ] or _unexplained(stated, number, _FEW_COARSE, one)
    return _merged(findings)


def _finding(one: Explanation, stated: Score, number: int) -> Finding:
    seen = f"{one.what} (score {one.score.total:.2f}, as sent {stated.total:.2f})"
    return Finding(one.code, seen, _WRONG_PLACE, one.remedy, (number,))


def _unexplained(
    stated: Score, number: int, few: int = FEW_PIXELS, coarse: Request | None = None
) -> list[Finding]:
    """What is said of an arm that is not where it should be, if no hypothesis is better."""
    disagrees = stated.agree < _DISAGREES and stated.through >= _NOT_HIDDEN
    is_elsewhere = stated.pixels >= few and (stated.through >= _SEEN_THROUGH or disagrees)
    if is_elsewhere or (coarse is not None and fits_turned(coarse, stated, few)):
        share = stated.pixels / max(stated.rendered, 1)
        agree, through = stated.agree * share, stated.through * share
        seen = (
            f"of the arm's pixels {agree:.0%} read it, {through:.0%} see through it, and no cause explains it"
        )
        effect = "the arm's readings count as obstacles, and what is behind it as the arm"
        remedy = "check that `state` is of the moment of the picture and in rad, and the camera's numbers"
        return [Finding(ELSEWHERE, seen, effect, remedy, (number,))]
    if stated.rendered < few // 3:
        seen = "almost none of the arm is in view by `state` and the camera's pose"
        effect = f"if the arm is in the picture, {_WRONG_PLACE}"
        remedy = "check the pose (x right, y down, z forward); ignore this if it looks past the arm"
        return [Finding(NOT_IN_VIEW, seen, effect, remedy, (number,))]
    return []


def diagnose(
    arm: SerialArm,
    sensor: DepthSensor,
    view: DepthView,
    cheap: Sequence[Finding],
    check_cancelled: CheckCancelled,
) -> Diagnosis:
    """Looks closely at a view; ``cheap`` are the warnings that other answers carry."""
    findings = [one for one in cheap if one.code not in POSE_CODES | {NOT_IN_VIEW}]
    notes, poses, others = list[str](), list[SuggestedPose](), list[tuple[DepthCamera, NDArray[np.float64]]]()
    is_moving = len(set(view.states)) > 1
    pictures = zip(view.pictures, view.cameras, view.states, strict=True)
    for number, (picture, camera, state) in enumerate(pictures):
        check_cancelled()
        smaller, own = reduced(np.where(in_range(picture), picture, np.uint16(0)), camera)
        depth_m = np.asarray(smaller * 1e-3, dtype=np.float64)
        read, (low, high) = depth_m[depth_m > 0.0], sensor.views.field_deg
        notes.append(
            f"picture {number}: {len(read) / depth_m.size:.0%} of the pixels read, half beyond "
            f"{np.median(read):.2f} m; {_field_deg(own):.0f} degrees wide, trained {low:.0f} to {high:.0f}"
        )
        found = [Finding(*words, (number,)) for words in _of_depths(read, depth_m.size)]
        if state is not None and arm.sphere_count:
            request = Request(arm, reduced(picture, camera)[0].astype(float), own, state)
            arm_found = _of_arm(request, number, check_cancelled)
            notes += arm_found.notes
            poses += arm_found.poses
            if arm_found.poses and number in view.on_link:
                notes.append(
                    f"picture {number}: its camera is on a link; the suggested pose is in the base frame, by "
                    "where this picture's `state` puts the link"
                )
            kept = self_filter(smaller, own, request.spheres).depth_mm
            rest_m = np.asarray(kept * 1e-3, dtype=np.float64)
            found += arm_found.findings or _of_rest(request, rest_m, number)
            # An arm that has moved is no reason why pictures should agree.
            depth_m = rest_m if is_moving else depth_m
        findings += found
        others.append((own, depth_m))
    findings += _of_pairs(others, check_cancelled)
    return Diagnosis(_merged(findings), tuple(notes), tuple(poses))


def _of_arm(one: Request, number: int, check_cancelled: CheckCancelled) -> Diagnosis:
    """The best explanations of where the arm is in a picture, if it is not where it should be."""
    stated = one.score()
    found = explanations(one, stated, EVERY, check_cancelled)
    better = clearly_better(found, stated)
    findings = [_finding(other, stated, number) for other in better]
    findings = findings or _unexplained(stated, number)
    poses = []
    for other in better:
        # The arm alone would also move a right camera to a wrong state.
        holds = other.score.base >= stated.base and other.score.level >= stated.level - TIE
        if other.code in _POSES and holds:
            camera, motion = other.meant.camera, other.meant.camera.matrix - one.camera.matrix
            turned = turn_deg(camera.matrix[:3, :3] @ one.camera.matrix[:3, :3].T)
            poses.append(SuggestedPose(number, camera.pose, float(np.linalg.norm(motion[:3, 3])), turned))
    if not findings and stated.rendered >= 2 * FEW_PIXELS and stated.blank > _BLANK_ARM:
        seen = f"{stated.blank:.0%} of the pixels that should show the arm read nothing"
        remedy = "look at the picture: the arm may be too dark or shiny, or the lens covered"
        findings = [Finding("holes", seen, "surfaces are missed", remedy, (number,))]
    scores = ", ".join(f"{other.code} {other.score.total:.2f}" for other in found[:3])
    note = f"picture {number}: score as sent {stated.total:.2f}; best {scores}"
    if not findings and stated.pixels:
        agrees = f"on {stated.agree:.0%} of {stated.pixels} pixels"
        note = f"picture {number}: the arm is where `state` and the pose say, {agrees}"
    return Diagnosis(tuple(findings), (note,), tuple(poses[:1]))


def _of_depths(read_m: NDArray[np.float64], pixels: int) -> Iterator[_Words]:
    if (share := len(read_m) / pixels) < _BLANK_PICTURE:
        yield (
            "blank",
            f"{share:.1%} of the pixels read something",
            "nearly all space counts as unseen",
            "look at the picture: the lens may be covered, or the scene too near, too dark or too bright",
        )
    if (far_m := np.percentile(read_m, 98)) < _NEAR_M:
        yield (
            "near-readings",
            f"nearly all readings are nearer than {far_m:.2f} m",
            f"if the unit is not mm, {_WRONG_PLACE}",
            "check depth_scale_m; ignore this for a camera at the hand",
        )


def _of_rest(one: Request, rest_m: NDArray[np.float64], number: int) -> list[Finding]:
    """Readings that the self filter leaves close round the arm's moving parts."""
    moving = one.spheres[one.arm.sphere_links() > 0]
    points = one.camera.points_m(rest_m)[rest_m > 0.0]
    left = int((to_surface(points, moving) < SLACK_M + _LEFT_M).sum()) if len(moving) else 0
    if left <= max(15, _LEFT_SHARE * rest_m.size):
        return []
    seen = f"{left} readings stay within {100 * (SLACK_M + _LEFT_M):.0f} cm of the arm beside its own"
    effect = "they count as obstacles that touch the arm"
    remedy = "if nothing stands there, add what the arm carries to its description, or check `state` and pose"
    return [Finding("arm-pixels-left", seen, effect, remedy, (number,))]


def _of_pairs(
    pictures: Sequence[tuple[DepthCamera, NDArray[np.float64]]], check_cancelled: CheckCancelled
) -> Iterator[Finding]:
    """Pictures that see through what others show."""
    for (number, (camera, depth_m)), (at, (other, beyond_m)) in permutations(enumerate(pictures), 2):
        check_cancelled()
        places = other.project(camera.points_m(depth_m)[depth_m > 0.0])
        places = places[other.shows(places)]
        columns, rows = np.rint(places[:, :2]).astype(int).T
        read = beyond_m[rows, columns]
        gap = (read - places[:, 2])[read > 0.0]
        if len(gap) < 2 * FEW_PIXELS or (share := float((gap > _THROUGH_M).mean())) < _THROUGH_SHARE:
            continue
        yield Finding(
            "cameras-disagree",
            f"picture {at} sees through {share:.0%} of the readings of picture {number}",
            "one of them is seen in a wrong place, or the scene has changed between them",
            "check the poses of both cameras, and that their pictures are of the same moment",
            (number, at),
        )
