"""Hypotheses about a depth picture, its camera and the state, and how well each fits. NumPy alone.

A hypothesis turns a request into the requests that were meant if it is true. One score compares all: how well
the readings agree with the arm, with the free space along their rays, and with what does not move.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cspace.world import CheckCancelled
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import FARTHEST_MM, NEAREST_MM, OPTICAL_IN_BODY, DepthCamera
from cspace.worlds.spatial.poses import MAX_PLACE_M, make_pose, pose_of, quaternion_of, quaternion_pose, turn
from cspace.worlds.spatial.visibility import arm_depth_m

Array = NDArray[np.float64]
# Readings so near to the rendered arm are the arm's, and those so far behind it are of what it hides.
AGREES_M, BEHIND_M = 0.03, 0.06
# Spheres that cover the arm stand out by so much at most.
_SKIN_M = 0.02
# Fewer pixels of the rendered arm say nothing.
FEW_PIXELS = 60
# Weights of a pixel that reads something before the arm, of the base link, and of a table's plane.
_BEFORE, _BASE, _LEVEL = 0.4, 1.0, 0.3
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
_HEIGHTS_M = np.concatenate(
    [np.arange(-0.3, 0.31, 0.03), np.arange(0.35, 1.3, 0.05), -np.arange(0.35, 1.3, 0.05)]
)
_BASELINES_M = (0.015, 0.025, 0.032, 0.05, 0.06, 0.075)


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """How well a request agrees with its picture, each from -1 or 0 to 1.

    Args:
        total: what hypotheses are compared by.
        arm: agreement less contradiction over the pixels that should show the arm.
        base: the same over those of the link that does not move; 0 where it is not in view.
        level: share of the readings beside the arm that lie in one horizontal plane.
        rendered: pixels that should show the arm, without its outline.
        pixels: those of them that read the arm or what it should hide.
        agree: share of ``pixels`` at the arm's depth.
        through: share of ``pixels`` behind it.
        blank: share of ``rendered`` that reads nothing.
    """

    total: float
    arm: float
    base: float
    level: float
    rendered: int
    pixels: int
    agree: float
    through: float
    blank: float


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
        """The same with another pose of the camera."""
        matrix[:3, 3] = np.clip(matrix[:3, 3], -MAX_PLACE_M, MAX_PLACE_M)
        return replace(self, camera=replace(self.camera, pose=pose_of(matrix)))

    def coarse(self) -> "Request":
        """The same with fewer pixels."""
        step = -(-max(self.units.shape) // _COARSE_SIDE)
        if step == 1:
            return self
        units, one = self.units[step // 2 :: step, step // 2 :: step], self.camera
        height, width = units.shape
        scaled = {"cx": (one.cx - step // 2) / step, "cy": (one.cy - step // 2) / step, "width": width}
        return replace(
            self,
            units=units,
            camera=replace(one, fx=one.fx / step, fy=one.fy / step, height=height, **scaled),
        )

    def score(self, least: int = FEW_PIXELS) -> Score:
        """Compares the picture with the arm as rendered; ``least`` pixels count at least."""
        rendered = arm_depth_m(self.camera, self.spheres)
        shown = _eroded(np.isfinite(rendered))
        still = shown & (arm_depth_m(self.camera, self.spheres[self.arm.sphere_links() == 0]) <= rendered)
        gap = np.where(shown & (self.depth_m > 0.0), self.depth_m - rendered, np.nan)
        near = gap[np.abs(gap) < AGREES_M]
        gap -= np.clip(np.median(near), 0.0, _SKIN_M) if len(near) else 0.0
        worth = np.where(gap > BEHIND_M, -1.0, np.clip(1.0 - (gap / AGREES_M) ** 2, 0.0, None))
        worth = np.nan_to_num(np.where(gap < -AGREES_M, -_BEFORE, worth))
        valid = gap[gap > -AGREES_M]
        count, total = int(shown.sum()), float(worth.sum())
        arm = total / max(count, least)
        base = float(worth[still].sum()) / max(int(still.sum()), least // 4)
        level = self._level(~np.isfinite(rendered))
        return Score(
            arm + _LEVEL * level + 0.2 * _BASE * base * bool(still.any()),
            arm, base, level, count, len(valid),
            float((np.abs(valid) < AGREES_M).mean()) if len(valid) else 0.0,
            float((valid > BEHIND_M).mean()) if len(valid) else 0.0,
            1.0 - float(np.isfinite(gap).sum()) / max(count, 1),
        )  # fmt: skip

    def _level(self, beside: NDArray[np.bool_]) -> float:
        points = self.camera.points_m(self.depth_m)[beside & (self.depth_m > 0.0)]
        if len(points) < FEW_PIXELS:
            return 0.0
        cell = 0.015 * float(np.median(np.linalg.norm(points - self.camera.matrix[:3, 3], axis=1)))
        counts = np.bincount(((points[:, 2] - points[:, 2].min()) / max(cell, 1e-6)).astype(int))
        return float(np.convolve(counts, (1, 1)).max()) / len(points)


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """What explains a picture: the code of a hypothesis, what was meant, its score, and what to do."""

    code: str
    meant: Request
    score: Score
    what: str = ""
    remedy: str = ""


Meant = Iterable[tuple[Request, str, str]]
Hypothesis = Callable[[Request], Meant]


def _unit(one: Request) -> Meant:
    for scale in _UNITS:
        unit = 1e-3 * scale
        yield (
            replace(one, scale_m=one.scale_m * scale),
            f"the arm's pixels read {1 / scale:g} times its distance",
            f"multiply depth_scale_m by {scale:g} (send {unit:g} if none was sent)",
        )


def _along_ray(one: Request) -> Meant:
    along = np.linalg.norm(one.camera.rays(), axis=-1)
    remedy = "divide each by sqrt(1 + ((u - cx) / fx)^2 + ((v - cy) / fy)^2)"
    yield replace(one, units=one.units / along), "the readings are distances along the ray", remedy


def _intrinsics(one: Request) -> Meant:
    was = one.camera
    centred = ((was.width / 2) / (was.cx + 0.5), (was.height / 2) / (was.cy + 0.5))
    for across, down in (*((size, size) for size in _SIZES), centred):
        cx, cy = (was.cx + 0.5) * across - 0.5, (was.cy + 0.5) * down - 0.5
        if (
            0.0 < cx < was.width
            and 0.0 < cy < was.height
            and (abs(across - 1.0) > 0.08 or abs(down - 1.0) > 0.08)
        ):
            meant = replace(one, camera=replace(was, fx=was.fx * across, fy=was.fy * down, cx=cx, cy=cy))
            what = f"the camera's numbers are of a picture {1 / across:.3g} x {1 / down:.3g} times as large"
            yield meant, what, "send fx, fy, cx and cy of this picture's size"
    swapped = replace(one, camera=replace(was, fx=was.fy, fy=was.fx))
    yield swapped, "fx and fy are swapped", "swap fx and fy"
    swapped = replace(one, camera=replace(was, cx=was.cy, cy=was.cx))
    yield swapped, "cx and cy are swapped", "swap cx and cy"


def _quaternion(one: Request) -> Meant:
    x, y, z, w = quaternion_of(one.camera.matrix[:3, :3])
    place = one.camera.matrix[:3, 3]
    for order, values in (("w, x, y, z", (y, z, w, x)), ("x, y, z, w, read as w, x, y, z", (w, x, y, z))):
        what, remedy = f"the quaternion is in the order {order}", "send it as x, y, z, w"
        yield one.with_pose(quaternion_pose(place, values)), what, remedy


def _inverse(one: Request) -> Meant:
    inverse = np.asarray(np.linalg.inv(one.camera.matrix), dtype=np.float64)
    yield one.with_pose(inverse), "the pose is of the robot's base in the camera", "send its inverse"


def _body_frame(one: Request) -> Meant:
    what = "the pose is of the camera's body (x forward, y left, z up)"
    yield one.with_pose(one.camera.matrix @ OPTICAL_IN_BODY), what, "send `frame` body beside it"


def _opengl(one: Request) -> Meant:
    turned, what = (
        np.diag([1.0, -1.0, -1.0, 1.0]),
        "the pose has y up and z backwards, as in OpenGL and Blender",
    )
    yield one.with_pose(one.camera.matrix @ turned), what, "turn both axes round"


def _transposed(one: Request) -> Meant:
    pose = one.camera.matrix
    pose[:3, :3] = pose[:3, :3].T
    yield (
        one.with_pose(pose),
        "the rotation of the pose is transposed",
        "transpose its rotation, not its place",
    )


def _translation_unit(one: Request) -> Meant:
    for scale, unit in ((0.01, "cm"), (0.001, "mm")):
        pose = one.camera.matrix
        pose[:3, 3] *= scale
        yield one.with_pose(pose), f"the place of the pose is in {unit}", "send it in m"


def _base_height(one: Request) -> Meant:
    found = best_of(one.coarse(), (_raised(one.coarse(), height) for height in _HEIGHTS_M))
    fit = fitted(
        one, lambda given, by: _raised(given, by[0]), [found.camera.pose[2][3] - one.camera.pose[2][3]]
    )
    up_m = fit.camera.pose[2][3] - one.camera.pose[2][3]
    what = f"the pose is in a frame {abs(up_m):.2f} m {'below' if up_m < 0 else 'above'} the arm's base"
    yield fit, what, f"add {up_m:.3f} m to its z, or send the pose in the frame of the arm's first link"


def _raised(one: Request, height_m: float) -> Request:
    pose = one.camera.matrix
    pose[2, 3] += height_m
    return one.with_pose(pose)


def _turned_about(axis: Array, one: Request, by: Array) -> Request:
    return _turned(one, axis * by[0])


def _joint(one: Request) -> Meant:
    few, is_near = one.coarse(), one.score().arm > _NEAR
    for joint, axis in enumerate(np.eye(one.arm.dim)):
        found = few if is_near else best_of(few, (_turned(few, axis * by) for by in _JOINT_SCAN_RAD))
        fit = fitted(
            one,
            partial(_turned_about, axis),
            [found.state[joint] - one.state[joint]],
        )
        off = fit.state[joint] - one.state[joint]
        what = f"joint {joint + 1} of `state` is off: it stands {off:+.3f} rad from what was sent"
        yield fit, what, "send `state` of the moment of the picture; check this joint's zero"


def _stale_state(one: Request) -> Meant:
    what, remedy = "the arm stands in another state", "send `state` of the moment of the picture, in rad"
    yield fitted(one, _turned, np.zeros(one.arm.dim)), what, remedy


def _turned(one: Request, by_rad: Array) -> Request:
    return replace(one, state=tuple(np.asarray(one.state) + by_rad))


def _permuted(one: Request) -> Meant:
    dim, state = one.arm.dim, np.asarray(one.state)
    orders = {tuple(range(dim))[::-1], *(tuple(np.roll(range(dim), by)) for by in (1, -1))}
    for first, second in combinations(range(dim), 2):
        orders.add(tuple({first: second, second: first}.get(joint, joint) for joint in range(dim)))
    for order in orders:
        names = ", ".join(str(joint + 1) for joint in order)
        yield (
            replace(one, state=tuple(state[list(order)])),
            f"the joints of `state` are in the order {names}",
            "sort them",
        )


def _upside_down(one: Request) -> Meant:
    what = "the picture is turned by 180 degrees against the pose"
    yield one.with_pose(one.camera.matrix @ np.diag([-1.0, -1.0, 1.0, 1.0])), what, "turn either of them"


def _mirrored(one: Request) -> Meant:
    yield replace(one, units=one.units[:, ::-1]), "the picture is mirrored, left and right", "mirror it back"
    yield replace(one, units=one.units[::-1]), "the picture is mirrored, top and bottom", "mirror it back"


def _rotated(one: Request) -> Meant:
    for turns in (1, 3):
        units = np.rot90(one.units, turns)
        camera = replace(one.camera, width=units.shape[1], height=units.shape[0])
        yield (
            replace(one, units=units, camera=camera),
            f"the picture is turned by {360 - 90 * turns} degrees",
            "turn it back",
        )


def _aligned(one: Request) -> Meant:
    for metres in _BASELINES_M:
        for offset in (metres, -metres):
            pose = one.camera.matrix @ make_pose(np.eye(3), (offset, 0.0, 0.0))
            what = f"the depth is aligned to another camera, {1e3 * offset:+.0f} mm beside this one"
            yield (
                one.with_pose(pose),
                what,
                "send the pose and the numbers of the camera that the depth is aligned to",
            )


def _moved_camera(one: Request) -> Meant:
    fit = fitted(one, moved, np.zeros(6))
    yield fit, "the camera stands elsewhere", "calibrate again or take the suggested pose"


def moved(one: Request, by: Array) -> Request:
    """With the camera moved by (6,): m, and rad about its own place as a rotation vector."""
    pose, angle = one.camera.matrix, float(np.linalg.norm(by[3:]))
    if angle > 0.0:
        pose[:3, :3] = turn(by[3:] / angle, angle) @ pose[:3, :3]
    pose[:3, 3] += by[:3]
    return one.with_pose(pose)


# Each with how much better it has to be than another: of two that fit alike the simpler one is named.
FRAMES: dict[str, tuple[Hypothesis, float]] = {
    "depth-unit": (_unit, 0.0),
    "quaternion-order": (_quaternion, 0.0),
    "inverted-pose": (_inverse, 0.0),
    "body-frame": (_body_frame, 0.0),
    "opengl-frame": (_opengl, 0.0),
    "transposed-rotation": (_transposed, 0.0),
    "translation-unit": (_translation_unit, 0.0),
    "upside-down": (_upside_down, 0.0),
}
HYPOTHESES = FRAMES | {
    "ray-distance": (_along_ray, 0.0),
    "intrinsics": (_intrinsics, 0.01),
    "mirrored-picture": (_mirrored, 0.0),
    "rotated-picture": (_rotated, 0.0),
    "joints-permuted": (_permuted, 0.05),
    "aligned-depth": (_aligned, 0.03),
    "base-height": (_base_height, 0.02),
    "joint-off": (_joint, 0.03),
    "extrinsics": (_moved_camera, 0.06),
    "state-off": (_stale_state, 0.08),
}


def best_of(one: Request, meant: Iterable[Request]) -> Request:
    """That of the highest score, the request itself included."""
    least = max(FEW_PIXELS // 4, one.score().rendered // 2)
    return max((one, *meant), key=lambda other: other.score(least).total)


def explanations(
    one: Request,
    stated: Score,
    hypotheses: dict[str, tuple[Hypothesis, float]],
    check_cancelled: CheckCancelled,
) -> Iterator[Explanation]:
    """The best of each hypothesis."""
    least = max(
        2 * FEW_PIXELS if max(one.units.shape) > _COARSE_SIDE else FEW_PIXELS // 4, int(0.4 * stated.rendered)
    )
    for code, (hypothesis, penalty) in hypotheses.items():
        found = []
        for meant, what, remedy in hypothesis(one):
            check_cancelled()
            found.append(Explanation(code, meant, meant.score(least), what, remedy))
        best = max(found, key=lambda other: other.score.total)
        yield replace(best, score=replace(best.score, total=best.score.total - penalty))


def fitted(
    one: Request, change: Callable[[Request, Array], Request], start: Sequence[float] | Array
) -> Request:
    """Gauss-Newton steps that bring the readings near the arm to its surface, with Tukey's weights."""
    by = np.asarray(start, dtype=np.float64)
    for gate_m in _GATES_M:
        points = one.camera.points_m(one.depth_m)[one.depth_m > 0.0]
        now = change(one, by)
        low, high = now.spheres[:, :3].min(axis=0) - 0.25, now.spheres[:, :3].max(axis=0) + 0.25
        there = _placed(points, one, now)
        points = points[((there > low) & (there < high)).all(axis=1)]
        points = points[:: -(-len(points) // _MOST_POINTS) or 1]
        for _ in range(_STEPS):
            now = change(one, by)
            gaps = to_surface(_placed(points, one, now), now.spheres)
            near = np.abs(gaps) < gate_m + _SKIN_M
            if near.sum() < _FEWEST_POINTS:
                return now
            points, gaps = points[near], gaps[near]
            others = [change(one, by + step) for step in 1e-4 * np.eye(len(by))]
            shifted = [to_surface(_placed(points, one, other), other.spheres) for other in others]
            jacobian = (np.stack(shifted, axis=1) - gaps[:, None]) / 1e-4
            gaps = gaps - np.clip(np.median(gaps), -_SKIN_M, 0.0)
            left = (jacobian * (np.clip(1.0 - (gaps / gate_m) ** 2, 0.0, None) ** 2)[:, None]).T
            step = -np.linalg.solve(left @ jacobian + _PRIOR * len(gaps) * np.eye(len(by)), left @ gaps)
            by = by + np.clip(step, -0.2, 0.2)
            if np.abs(step).max() < 5e-4:
                break
    return change(one, by)


def _placed(points: Array, was: Request, now: Request) -> Array:
    """Points in the base by one camera's pose, by another's."""
    if was.camera is now.camera:
        return points
    motion = now.camera.matrix @ np.linalg.inv(was.camera.matrix)
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3])


def to_surface(points: Array, spheres: Array) -> Array:
    """Signed distances (N,) m of points to the union of spheres."""
    centres = spheres[:, :3]
    square = (points**2).sum(axis=1)[:, None] + (centres**2).sum(axis=1) - 2.0 * points @ centres.T
    return np.asarray((np.sqrt(np.maximum(square, 0.0)) - spheres[:, 3]).min(axis=1))


def _eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels whose eight neighbours are set as well; those beyond the picture count as set."""
    wide = np.pad(mask, 1, constant_values=True)
    rows = wide[:-2] & wide[1:-1] & wide[2:]
    return np.asarray(rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:])
