"""Extrinsics tested by the arm: its depth as rendered at ``state`` against the picture. NumPy alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cspace.world import CheckCancelled
from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.poses import make_pose, moved, pose_of, turn
from cspace.worlds.spatial.visibility import arm_depth_m

Depth = NDArray[np.float64]
# Readings so near to the rendered arm are the arm's, and those so far behind it are of what it hides.
AGREES_M, BEHIND_M = 0.03, 0.06
# Points so far from the arm's surface take part in the fit, from its first step to its last.
_GATES_M = (0.15, 0.10, 0.07, 0.05, 0.035, 0.025)
# Gates to begin with: a wide one finds what is far off, a narrow one is not led astray by what stands near.
_STARTS = (0, 3)
# Where to begin as well if nothing fits from the told pose so far: beside it, along the camera's axes.
_FITS, _ASIDE_M = 0.75, 0.1 * np.eye(3)
# Distances of points to spheres that are computed at once, in some ms.
_AT_ONCE = 400_000
_STEPS, _MOST_POINTS, _FEWEST_POINTS = 5, 800, 30
# What is assumed before anything is seen: of the motion, of how far spheres that cover the arm stand out, and
# of a reading, whose neighbours err with it.
_PRIOR_M, _PRIOR_RAD, _SKIN_M, _READING_M = 0.05, 0.05, 0.01, 0.03


@dataclass(frozen=True, slots=True)
class ArmMatch:
    """How an arm as rendered agrees with a picture; pixels along its outline do not count.

    Args:
        rendered: pixels that should show the arm.
        pixels: those of them that read the arm, or what it should hide; others read what stands before it.
        agree: share of ``pixels`` that read the arm's depth.
        through: share of ``pixels`` that read what the arm should hide.
        blank: share of ``rendered`` that read nothing.
        quality: mean of 1 for a reading at the arm's depth, falling to 0 at :data:`AGREES_M`.
    """

    rendered: int
    pixels: int
    agree: float
    through: float
    blank: float
    quality: float


def arm_match(
    depth_m: Depth,
    camera: DepthCamera,
    spheres: NDArray[np.float64],
    check_cancelled: CheckCancelled = lambda: None,
) -> ArmMatch:
    """Compares a picture (H, W) m, 0 = no reading, with spheres (S, 4) m that cover the arm."""
    rendered = arm_depth_m(camera, spheres, check_cancelled)
    inner = _eroded(np.isfinite(rendered))
    read = inner & (depth_m > 0.0)
    gap = (depth_m - rendered)[read]
    valid_gap = gap[gap > -AGREES_M]
    if not len(valid_gap):
        return ArmMatch(int(inner.sum()), 0, 0.0, 0.0, 1.0 - len(gap) / max(int(inner.sum()), 1), 0.0)
    return ArmMatch(
        int(inner.sum()),
        len(valid_gap),
        float((valid_gap < AGREES_M).mean()),
        float((valid_gap > BEHIND_M).mean()),
        1.0 - len(gap) / int(inner.sum()),
        float((np.clip(1.0 - (valid_gap / AGREES_M) ** 2, 0.0, None) ** 2).mean()),
    )


@dataclass(frozen=True, slots=True)
class PoseFit:
    """A camera's pose by which the arm in its picture lies on the arm as it stands.

    Args:
        camera: with that pose.
        shift_m: how far the readings on the arm move by it, the root of the mean square.
        before_m: median distance of these readings from the arm's surface, as told.
        after_m: likewise with the pose.
        stated: match of the arm as told.
        match: match with the pose.
    """

    camera: DepthCamera
    shift_m: float
    before_m: float
    after_m: float
    stated: ArmMatch
    match: ArmMatch


def fit_pose(
    depth_m: Depth,
    camera: DepthCamera,
    spheres: NDArray[np.float64],
    check_cancelled: CheckCancelled = lambda: None,
) -> PoseFit | None:
    """Moves a camera until its readings near the arm lie on the arm's surface.

    Gauss-Newton steps on the signed distances of points to the spheres, over a rigid motion in the base frame
    and a common inset of the surface (spheres cover the arm, so that they stand out), with Tukey's weights
    whose gate narrows. Begins at the told pose; where nothing fits from there, also beside it.

    Args:
        depth_m: (H, W), 0 = no reading.
        camera: as told.
        spheres: (S, 4) that cover the arm as it stands.
        check_cancelled: called between steps; what it raises passes through.

    Returns:
        None where too few readings lie near the arm.
    """
    read = camera.points_m(depth_m)[depth_m > 0.0]
    starts = [(np.zeros(3), first) for first in _STARTS]
    best: PoseFit | None = None
    for offset_m, first in (*starts, *((sign * axis, 0) for axis in _ASIDE_M for sign in (1.0, -1.0))):
        if offset_m.any() and best is not None and best.match.agree >= _FITS:
            break
        begin = make_pose(np.eye(3), camera.matrix[:3, :3] @ offset_m)
        points = near_arm(moved(begin, read), spheres, _GATES_M[0], check_cancelled) - begin[:3, 3]
        points = points[:: max(1, -(-len(points) // _MOST_POINTS))]
        if len(points) < _FEWEST_POINTS:
            continue
        fit = _fit(depth_m, camera, spheres, points, _GATES_M[first:], begin, check_cancelled)
        if fit is not None and (best is None or fit.match.quality > best.match.quality):
            best = fit
    return best


def near_arm(
    points_m: NDArray[np.float64],
    spheres: NDArray[np.float64],
    within_m: float,
    check_cancelled: CheckCancelled = lambda: None,
) -> NDArray[np.float64]:
    """Those of points (N, 3) whose distance to the surface of spheres (S, 4) is below ``within_m``."""
    kept = [points_m[:0]]
    if not len(spheres):
        return kept[0]
    for some in np.array_split(points_m, -(-len(points_m) * len(spheres) // _AT_ONCE) or 1):
        check_cancelled()
        kept.append(some[np.abs(_to_surface(some, spheres)[0]) < within_m])
    return np.concatenate(kept)


def _fit(
    depth_m: Depth,
    camera: DepthCamera,
    spheres: NDArray[np.float64],
    points: NDArray[np.float64],
    gates_m: Sequence[float],
    motion: NDArray[np.float64],
    check_cancelled: CheckCancelled,
) -> PoseFit | None:
    pivot, skin_m = points.mean(axis=0), 0.0
    for gate_m in gates_m:
        for _ in range(_STEPS):
            check_cancelled()
            step, skin_m = _step(moved(motion, points), spheres, gate_m, motion, pivot, skin_m)
            motion = step @ motion
            if np.abs(step - np.eye(4)).max() < 1e-4:
                break
    after = np.abs(_to_surface(moved(motion, points), spheres)[0] - skin_m)
    on_arm = after < gates_m[-1]
    if on_arm.sum() < _FEWEST_POINTS:
        return None
    before = np.abs(_to_surface(points[on_arm], spheres)[0] - skin_m)
    shifts = (moved(motion, points) - points)[on_arm]
    found = replace(camera, pose=pose_of(motion @ camera.matrix))
    shrunk = np.column_stack([spheres[:, :3], np.maximum(spheres[:, 3] + skin_m, 1e-3)])
    return PoseFit(
        found,
        float(np.sqrt((shifts**2).sum(axis=1).mean())),
        float(np.median(before)),
        float(np.median(after[on_arm])),
        arm_match(depth_m, camera, shrunk, check_cancelled),
        arm_match(depth_m, found, shrunk, check_cancelled),
    )


def turn_deg(rotation: NDArray[np.float64]) -> float:
    """How far a rotation (3, 3) turns."""
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))))


def _step(
    points: NDArray[np.float64],
    spheres: NDArray[np.float64],
    gate_m: float,
    motion: NDArray[np.float64],
    pivot: NDArray[np.float64],
    skin_m: float,
) -> tuple[NDArray[np.float64], float]:
    """A Gauss-Newton step (4, 4) of points that a motion so far has moved, and the inset after it."""
    gaps, normals = _to_surface(points, spheres)
    gaps = gaps - skin_m
    weights = np.clip(1.0 - (gaps / gate_m) ** 2, 0.0, None) ** 2
    rows = np.concatenate([normals, np.cross(points - pivot, normals), -np.ones((len(points), 1))], axis=1)
    scaled = rows * (weights / _READING_M**2)[:, None]
    so_far = np.append(_parameters(motion, pivot), skin_m)
    prior = 1.0 / np.repeat([_PRIOR_M, _PRIOR_RAD, _SKIN_M], (3, 3, 1)) ** 2
    change = -np.linalg.solve(scaled.T @ rows + np.diag(prior), scaled.T @ gaps + prior * so_far)
    angle = float(np.linalg.norm(change[3:6]))
    rotation = turn(change[3:6] / angle, angle) if angle > 0.0 else np.eye(3)
    return make_pose(rotation, pivot + change[:3] - rotation @ pivot), skin_m + float(change[6])


def _parameters(motion: NDArray[np.float64], pivot: NDArray[np.float64]) -> NDArray[np.float64]:
    """A small motion as the pivot's shift and the vector of its rotation, (6,)."""
    rotation = motion[:3, :3]
    skew = 0.5 * (rotation - rotation.T)
    return np.concatenate([rotation @ pivot + motion[:3, 3] - pivot, [skew[2, 1], skew[0, 2], skew[1, 0]]])


def _to_surface(
    points: NDArray[np.float64], spheres: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signed distances (N,) m of points to the union of spheres, and the directions away from it (N, 3)."""
    centres = spheres[:, :3]
    square = (points**2).sum(axis=1)[:, None] + (centres**2).sum(axis=1) - 2.0 * points @ centres.T
    nearest = np.argmin(np.sqrt(np.maximum(square, 0.0)) - spheres[:, 3], axis=1)
    offsets = points - centres[nearest]
    away = np.linalg.norm(offsets, axis=1)
    return away - spheres[nearest, 3], offsets / np.maximum(away, 1e-9)[:, None]


def _eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels whose eight neighbours are set as well; those beyond the picture count as set."""
    wide = np.pad(mask, 1, constant_values=True)
    rows = wide[:-2] & wide[1:-1] & wide[2:]
    return np.asarray(rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:])
