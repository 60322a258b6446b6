"""Hypotheses about a depth picture, its camera and the state, each a request that may have been meant.

One score compares all: how well readings agree with the arm as rendered, and with what does not move.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.world import CAUSES, CheckCancelled
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import FARTHEST_MM, NEAREST_MM, OPTICAL_IN_BODY, DepthCamera
from cspace.worlds.spatial.poses import (
    MAX_PLACE_M,
    make_pose,
    moved,
    pose_of,
    quaternion_of,
    quaternion_pose,
    turn,
)
from cspace.worlds.spatial.visibility import arm_depth_m

Array = NDArray[np.float64]
# Readings so near to the rendered arm are the arm's, and those so far behind it are of what it hides.
AGREES_M, BEHIND_M = 0.03, 0.06
# Spheres that cover the arm stand out by so much at most.
_SKIN_M = 0.02
# Fewer pixels of the rendered arm say nothing.
FEW_PIXELS = 60
# Weights of a pixel that reads something before the arm, of the base link, and of a table's plane.
_BEFORE, _BASE, _LEVEL = 0.4, 0.2, 0.3
# A scan looks at every n-th pixel so that the longer side has at most so many.
_COARSE_SIDE = 48
# Distances from the arm of the readings that take part in a fit, from its first step to its last.
_GATES_M = (0.12, 0.08, 0.05, 0.03)
_STEPS, _MOST_POINTS, _FEWEST_POINTS, _PRIOR = 4, 800, 20, 6e-4
# Above this score of the arm a scan is of no use.
_NEAR = 0.6
_UNITS = (0.1, 10.0, 1000.0, 0.2, 5.0, 0.25, 4.0, 0.125, 8.0, 1 / 16, 16.0)
_SIZES = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0, 4.0)
_JOINT_SCAN_RAD = (*np.arange(-0.75, 0.8, 0.15), *np.arange(-3.1, -0.9, 0.35), *np.arange(1.0, 3.2, 0.35))
_HEIGHTS_M = (*np.arange(-0.3, 0.31, 0.03), *np.arange(0.35, 1.3, 0.05), *-np.arange(0.35, 1.3, 0.05))
# A camera turned so far that fits so well, and so much better, shows that the arm is elsewhere.
_TURNS_RAD, _MOST, _CLEARLY = np.radians((-11.0, -6.0, 6.0, 11.0)), 0.7, 0.4
# How much better than the request as sent a hypothesis has to be, how well it has to fit, and what ties.
BETTER, _FITS, _LEAST, TIE = 0.06, 0.5, 0.25, 0.02
_BASELINES_M = (0.015, 0.025, 0.032, 0.05, 0.06, 0.075)


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """How well a request agrees with its picture, each from -1 or 0 to 1."""

    total: float  # what hypotheses are compared by
    arm: float  # agreement less contradiction over the pixels that should show the arm
    base: float  # the same over those of the link that does not move; 0 where it is not in view
    level: float  # share of the readings beside the arm that lie in one horizontal plane
    rendered: int  # pixels that should show the arm, without its outline
    pixels: int  # those of them that read the arm or what it should hide
    agree: float  # share of `pixels` at the arm's depth
    through: float  # share of `pixels` behind it
    blank: float  # share of `rendered` that reads nothing


@dataclass(frozen=True, eq=False)
class Request:
    """A picture as it came, (H, W) in units, with its camera and the state (d,) of the arm."""

    arm: SerialArm
    units: Array
    camera: DepthCamera
    state: tuple[float, ...]
    scale_m: float = 1e-3

    @cached_property
    def depth_m(self) -> Array:
        """(H, W), 0 = no reading."""
        found = self.units * self.scale_m
        return np.where((found >= 1e-3 * NEAREST_MM) & (found <= 1e-3 * FARTHEST_MM), found, 0.0)

    @cached_property
    def spheres(self) -> Array:
        """(S, 4) of the arm where the state puts it."""
        return self.arm.spheres_at(self.state)

    def with_pose(self, matrix: Array) -> "Request":
        place = np.clip(matrix[:3, 3], -MAX_PLACE_M, MAX_PLACE_M)
        return replace(self, camera=replace(self.camera, pose=pose_of(make_pose(matrix[:3, :3], place))))

    def coarse(self) -> "Request":
        step, one = -(-max(self.units.shape) // _COARSE_SIDE), self.camera
        units = self.units[step // 2 :: step, step // 2 :: step]
        cx, cy = (one.cx - step // 2) / step, (one.cy - step // 2) / step
        height, width = units.shape
        camera = replace(one, fx=one.fx / step, fy=one.fy / step, cx=cx, cy=cy, width=width, height=height)
        return replace(self, units=units, camera=camera)

    def score(self, least: int = FEW_PIXELS) -> Score:
        """Compares the picture with the arm as rendered; ``least`` pixels count at least."""
        rendered = arm_depth_m(self.camera, self.spheres)
        # Pixels whose eight neighbours show it as well; those beyond the picture count as such.
        wide = np.pad(np.isfinite(rendered), 1, constant_values=True)
        rows = wide[:-2] & wide[1:-1] & wide[2:]
        shown = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
        still = shown & (arm_depth_m(self.camera, self.spheres[self.arm.sphere_links() == 0]) <= rendered)
        gap = np.where(shown & (self.depth_m > 0.0), self.depth_m - rendered, np.nan)
        near = gap[np.abs(gap) < AGREES_M]
        gap -= np.clip(np.median(near), 0.0, _SKIN_M) if len(near) else 0.0
        worth = np.where(gap > BEHIND_M, -1.0, np.clip(1.0 - (gap / AGREES_M) ** 2, 0.0, None))
        worth = np.nan_to_num(np.where(gap < -AGREES_M, -_BEFORE, worth))
        valid = gap[gap > -AGREES_M]
        count = int(shown.sum())
        arm = float(worth.sum()) / max(count, least)
        base = float(worth[still].sum()) / max(int(still.sum()), least // 4)
        level = self._level(~np.isfinite(rendered))
        return Score(
            total=arm + _LEVEL * level + _BASE * base,
            arm=arm,
            base=base,
            level=level,
            rendered=count,
            pixels=len(valid),
            agree=float((np.abs(valid) < AGREES_M).mean()) if len(valid) else 0.0,
            through=float((valid > BEHIND_M).mean()) if len(valid) else 0.0,
            blank=1.0 - float(np.isfinite(gap).sum()) / max(count, 1),
        )

    def _level(self, beside: NDArray[np.bool_]) -> float:
        points = self.camera.points_m(self.depth_m)[beside & (self.depth_m > 0.0)]
        if len(points) < FEW_PIXELS:
            return 0.0
        cell = 0.015 * float(np.median(np.linalg.norm(points - self.camera.matrix[:3, 3], axis=1)))
        counts = np.bincount(((points[:, 2] - points[:, 2].min()) / max(cell, 1e-6)).astype(int))
        return float(np.convolve(counts, (1, 1)).max()) / len(points)


# What may have been meant: the code of its cause, the request, what is wrong then, and a remedy.
Meant = Iterator[tuple[str, Request, str, str]]
Hypothesis = Callable[[Request], Meant]


def _frames(one: Request) -> Meant:
    pose = one.camera.matrix
    rotation, place = pose[:3, :3], pose[:3, 3]
    x, y, z, w = quaternion_of(rotation)
    wxyz, xyzw = quaternion_pose(place, (y, z, w, x)), quaternion_pose(place, (w, x, y, z))
    opengl, on_head = pose @ np.diag([1.0, -1.0, -1.0, 1.0]), pose @ np.diag([-1.0, -1.0, 1.0, 1.0])
    transposed, inverse = make_pose(rotation.T, place), np.asarray(np.linalg.inv(pose), dtype=np.float64)
    in_cm, in_mm = make_pose(rotation, 0.01 * place), make_pose(rotation, 0.001 * place)
    for code, matrix, what, remedy in (
        ("quaternion-order", wxyz, "the quaternion is in the order w, x, y, z", "send it as x, y, z, w"),
        ("quaternion-order", xyzw, "the quaternion was read as w, x, y, z", "send it as x, y, z, w"),
        ("inverted-pose", inverse, "the pose is of the base in the camera", "send its inverse"),
        ("body-frame", pose @ OPTICAL_IN_BODY, "the pose is of the camera's body", "send `frame` body"),
        ("opengl-frame", opengl, "the pose has y up and z backwards, as in OpenGL", "turn both axes round"),
        ("transposed-rotation", transposed, "the rotation is transposed", "transpose it, not the place"),
        ("translation-unit", in_cm, "the place of the pose is in cm", "send it in m"),
        ("translation-unit", in_mm, "the place of the pose is in mm", "send it in m"),
        ("upside-down", on_head, "the picture is on its head against the pose", "turn either of them"),
    ):
        yield code, one.with_pose(matrix), what, remedy


def _unit(one: Request) -> Meant:
    for scale in _UNITS:
        what = f"the arm's pixels read {1 / scale:g} times its distance"
        remedy = f"multiply depth_scale_m by {scale:g} (send {1e-3 * scale:g} if none was sent)"
        yield "depth-unit", replace(one, scale_m=one.scale_m * scale), what, remedy


def _pictures(one: Request) -> Meant:
    along = replace(one, units=one.units / np.linalg.norm(one.camera.rays(), axis=-1))
    remedy = "divide each by sqrt(1 + ((u - cx) / fx)^2 + ((v - cy) / fy)^2)"
    yield "ray-distance", along, "the readings are distances along the ray", remedy
    for sides, units in (("left and right", one.units[:, ::-1]), ("top and bottom", one.units[::-1])):
        what = f"the picture is mirrored, {sides}"
        yield "mirrored-picture", replace(one, units=units), what, "mirror it back"
    for turns in (1, 3):
        units = np.rot90(one.units, turns)
        camera = replace(one.camera, width=units.shape[1], height=units.shape[0])
        what = f"the picture is turned by {360 - 90 * turns} degrees"
        yield "rotated-picture", replace(one, units=units, camera=camera), what, "turn it back"


def _intrinsics(one: Request) -> Meant:
    was = one.camera
    centred = ((was.width / 2) / (was.cx + 0.5), (was.height / 2) / (was.cy + 0.5))
    for across, down in (*((size, size) for size in _SIZES), centred):
        cx, cy = (was.cx + 0.5) * across - 0.5, (was.cy + 0.5) * down - 0.5
        is_inside = 0.0 < cx < was.width and 0.0 < cy < was.height
        if is_inside and max(abs(across - 1.0), abs(down - 1.0)) > 0.08:
            meant = replace(one, camera=replace(was, fx=was.fx * across, fy=was.fy * down, cx=cx, cy=cy))
            what = f"the camera's numbers are of a picture {1 / across:.3g} x {1 / down:.3g} times as large"
            yield "intrinsics", meant, what, "send fx, fy, cx and cy of this picture's size"
    for names, camera in (
        ("fx and fy", replace(was, fx=was.fy, fy=was.fx)),
        ("cx and cy", replace(was, cx=was.cy, cy=was.cx)),
    ):
        yield "intrinsics", replace(one, camera=camera), f"{names} are swapped", f"swap {names}"


def _aligned(one: Request) -> Meant:
    remedy = "send the pose and the numbers of the camera that the depth is aligned to"
    for offset in (*_BASELINES_M, *(-metres for metres in _BASELINES_M)):
        what = f"the depth is aligned to another camera, {1e3 * offset:+.0f} mm beside this one"
        pose = one.camera.matrix @ make_pose(np.eye(3), (offset, 0.0, 0.0))
        yield "aligned-depth", one.with_pose(pose), what, remedy


def _base_height(one: Request) -> Meant:
    few = one.coarse()
    found = best_of(few, (_raised(few, [height]) for height in _HEIGHTS_M))
    fit = fitted(one, _raised, found.camera.matrix[2:3, 3] - one.camera.matrix[2:3, 3])
    up_m = fit.camera.matrix[2, 3] - one.camera.matrix[2, 3]
    what = f"the pose is in a frame {abs(up_m):.2f} m {'below' if up_m < 0 else 'above'} the arm's base"
    remedy = f"add {up_m:.3f} m to its z, or send the pose in the frame of the arm's first link"
    yield "base-height", fit, what, remedy


def _raised(one: Request, by_m: Sequence[float] | Array) -> Request:
    return camera_moved(one, np.array([0.0, 0.0, by_m[0], 0.0, 0.0, 0.0]))


def camera_moved(one: Request, by: Array) -> Request:
    """With the camera moved by (6,): m, and rad about its own place as a rotation vector."""
    pose, angle = one.camera.matrix, float(np.linalg.norm(by[3:]))
    rotation = turn(by[3:] / angle, angle) @ pose[:3, :3] if angle > 0.0 else pose[:3, :3]
    return one.with_pose(make_pose(rotation, pose[:3, 3] + by[:3]))


def _joint(one: Request) -> Meant:
    few, is_near = one.coarse(), one.score().arm > _NEAR
    for joint, axis in enumerate(np.eye(one.arm.dim)):
        found = few if is_near else best_of(few, (_turned(few, axis * by) for by in _JOINT_SCAN_RAD))
        start = [found.state[joint] - one.state[joint]]
        fit = fitted(one, partial(_turned, axis=axis), start)
        off = fit.state[joint] - one.state[joint]
        what = f"joint {joint + 1} of `state` is off: it stands {off:+.3f} rad from what was sent"
        yield "joint-off", fit, what, "send `state` of the moment of the picture; check this joint's zero"


def _all_moved(one: Request) -> Meant:
    fit, remedy = fitted(one, camera_moved, np.zeros(6)), "calibrate again or take the suggested pose"
    yield "extrinsics", fit, "the camera stands elsewhere", remedy
    fit, remedy = (
        fitted(one, _turned, np.zeros(one.arm.dim)),
        "send `state` of the moment of the picture, in rad",
    )
    yield "state-off", fit, "the arm stands in another state", remedy


def _turned(one: Request, by_rad: Array, axis: Array | float = 1.0) -> Request:
    return replace(one, state=tuple(np.asarray(one.state) + axis * by_rad))


def _permuted(one: Request) -> Meant:
    joints, state = list(range(one.arm.dim)), np.asarray(one.state)
    orders = {tuple(joints[::-1]), tuple(np.roll(joints, 1)), tuple(np.roll(joints, -1))}
    for first, second in combinations(joints, 2):
        orders.add(tuple({first: second, second: first}.get(joint, joint) for joint in joints))
    for order in orders:
        what = f"the joints of `state` are in the order {', '.join(str(joint + 1) for joint in order)}"
        yield "joints-permuted", replace(one, state=tuple(state[list(order)])), what, "sort them"


FRAMES: tuple[Hypothesis, ...] = (_unit, _frames)
EVERY: tuple[Hypothesis, ...] = (
    *(*FRAMES, _pictures, _intrinsics, _permuted, _aligned),
    *(_base_height, _joint, _all_moved),
)
# How much better each cause has to be than another: of two that fit alike the simpler one is named.
HYPOTHESES = dict.fromkeys((*CAUSES, "ray-distance", "mirrored-picture", "rotated-picture"), 0.0) | {
    "intrinsics": 0.01,
    "joints-permuted": 0.05,
    "aligned-depth": 0.03,
    "base-height": 0.02,
    "joint-off": 0.03,
    "extrinsics": 0.06,
    "state-off": 0.08,
}


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """What explains a picture: the code of a cause, what was meant, its score, and what to do."""

    code: str
    meant: Request
    score: Score
    what: str
    remedy: str


def explanations(
    one: Request, stated: Score, hypotheses: Iterable[Hypothesis], check_cancelled: CheckCancelled
) -> list[Explanation]:
    """The best of each cause, by score."""
    few = 2 * FEW_PIXELS if max(one.units.shape) > _COARSE_SIDE else FEW_PIXELS // 4
    least, best = max(few, int(0.4 * stated.rendered)), dict[str, Explanation]()
    for code, meant, what, remedy in chain.from_iterable(hypothesis(one) for hypothesis in hypotheses):
        check_cancelled()
        score = meant.score(least)
        score = replace(score, total=score.total - HYPOTHESES[code])
        if code not in best or score.total > best[code].score.total:
            best[code] = Explanation(code, meant, score, what, remedy)
    return sorted(best.values(), key=lambda found: -found.score.total)


def clearly_better(found: Sequence[Explanation], stated: Score, by: float = BETTER) -> list[Explanation]:
    """What is clearly better than the request as sent, of the best first: that, and one that ties with it."""
    good = [one for one in found if one.score.total > stated.total + by]
    good = [one for one in good if one.score.arm >= max(_FITS * (1.0 - one.score.blank), _LEAST)]
    return [one for one in good[:2] if one.score.total > good[0].score.total - TIE]


def best_of(one: Request, meant: Iterable[Request]) -> Request:
    """That of the highest score, the request itself included."""
    least = max(FEW_PIXELS // 4, one.score().rendered // 2)
    return max((one, *meant), key=lambda other: other.score(least).total)


def fits_turned(one: Request, stated: Score, few: int) -> bool:
    """Whether a camera that is turned a little sees the arm clearly better, and most of it."""
    turns = np.outer(_TURNS_RAD, np.eye(3)).reshape(-1, 3)
    found = best_of(one, (camera_moved(one, np.append(np.zeros(3), by)) for by in turns)).score(few)
    is_seen = found.pixels >= few and found.arm >= _MOST * (1.0 - found.blank)
    return is_seen and found.total > stated.total + _CLEARLY


def fitted(one: Request, change: Callable[[Request, Array], Request], start: ArrayLike) -> Request:
    """Gauss-Newton steps that bring the readings near the arm to its surface, with Tukey's weights."""
    by = np.asarray(start, dtype=np.float64)
    # In the camera's frame.
    read = (one.camera.rays() * one.depth_m[..., None])[one.depth_m > 0.0]
    for gate_m in _GATES_M:
        now = change(one, by)
        centres, there = now.spheres[:, :3], moved(now.camera.matrix, read)
        points = read[((there > centres.min(0) - 0.25) & (there < centres.max(0) + 0.25)).all(axis=1)]
        points = points[:: -(-len(points) // _MOST_POINTS) or 1]
        for _ in range(_STEPS):
            now = change(one, by)
            gaps = to_surface(moved(now.camera.matrix, points), now.spheres)
            near = np.abs(gaps) < gate_m + _SKIN_M
            if near.sum() < _FEWEST_POINTS:
                return now
            points, gaps = points[near], gaps[near]
            others = [change(one, by + step) for step in 1e-4 * np.eye(len(by))]
            beside = [to_surface(moved(other.camera.matrix, points), other.spheres) for other in others]
            jacobian = (np.stack(beside, axis=1) - gaps[:, None]) / 1e-4
            gaps = gaps - np.clip(np.median(gaps), -_SKIN_M, 0.0)
            left = (jacobian * (np.clip(1.0 - (gaps / gate_m) ** 2, 0.0, None) ** 2)[:, None]).T
            step = -np.linalg.solve(left @ jacobian + _PRIOR * len(gaps) * np.eye(len(by)), left @ gaps)
            by = by + np.clip(step, -0.2, 0.2)
            if np.abs(step).max() < 5e-4:
                break
    return change(one, by)


def to_surface(points: Array, spheres: Array) -> Array:
    """Signed distances (N,) m of points to the union of spheres."""
    centres = spheres[:, :3]
    square = (points**2).sum(axis=1)[:, None] + (centres**2).sum(axis=1) - 2.0 * points @ centres.T
    return np.asarray((np.sqrt(np.maximum(square, 0.0)) - spheres[:, 3]).min(axis=1))
