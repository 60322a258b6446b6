"""A planning scene as checks of one arm, which is an arm again with what is attached to it. Compiled."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError
from cspace.view_file import MAX_MESHES, MAX_TRIANGLES
from cspace.world import CheckCancelled, Contact
from cspace.worlds.spatial.arm import MAX_SPHERES, TOOL, Part, SerialArm
from cspace.worlds.spatial.bodies import are_inside, part_contact, points_to_bodies, write_body
from cspace.worlds.spatial.collision import KERNELS, scene_arrays
from cspace.worlds.spatial.kinematics import arm_arrays, sphere_centres_batch
from cspace.worlds.spatial.obstacles import BodyArrays, Obstacles, body_arrays, kernel_row
from cspace.worlds.spatial.planning_scene import Attached, Body, BoxShape, PlanningScene
from cspace.worlds.spatial.poses import HERE, moved, vector
from cspace.worlds.spatial.sensor import NO_READING, OUT_OF_VIEW, GridBox
from cspace.worlds.spatial.visibility import SLACK_M, lookup

# The base stands where it stands.
_STILL = 0
# So many spheres of the arm, times triangles and bodies, are looked at in some ms.
_AT_ONCE = 500_000
# Spheres that cover an attached body, most; the least side of the cells that they are about.
_MOST_SPHERES, _CELL_M, _COARSER = 1024, 0.005, 1.1
# So deep a body may touch others, for less of its spheres to stick out.
_BARE_M = 0.003
# Half diagonals of a cell that the middle of a sphere may move inwards.
_INWARDS = (0.0, 1.0, 3.0)
# A cell is looked at in so many parts along each side.
_PARTS = 6
_MOST_CELLS = 100_000
_UNSEEN = {NO_READING: "unread", OUT_OF_VIEW: "out of view"}


class SceneChecker:
    """A planning scene for one arm, as checks take it; needs the compiler."""

    def __init__(self, arm: SerialArm, known: PlanningScene) -> None:
        self.known = known
        self.seen: NDArray[np.uint8] | None = None
        meshes = known.corners_m()
        counts = [len(meshes[one.mesh.file]) for one in known.bodies if one.mesh is not None]
        if len(counts) > MAX_MESHES or sum(counts) > MAX_TRIANGLES:
            raise InputError(
                "the bodies have too many meshes, or too fine ones",
                expected=f"at most {MAX_MESHES} bodies with a mesh, of {MAX_TRIANGLES} triangles together",
                got=f"{len(counts)} of {sum(counts)}",
                remedy="simplify the meshes, or send boxes and cylinders about them",
            )
        self.bodies = bodies_of(known.scene, meshes)
        self.ignored = bodies_of(known.ignore, meshes)
        self._check_names(arm)
        self.arm = self._holding(arm, meshes)
        allowed = {frozenset(pair) for pair in known.allowed}
        # The base stands where it stands.
        exempt = [
            [part.link == _STILL or frozenset((part.name, name)) in allowed for name in self.names]
            for part in self.arm.parts
        ]
        shape = (len(self.arm.parts), len(self.names))
        self.bodies = self.bodies._replace(exempt=np.asarray(exempt, dtype=np.bool_).reshape(shape))
        held = {one.name for one in known.attached}
        pairs = tuple(pair for pair in self.arm.touching if held & set(pair))
        limits = np.full(arm.dim, np.inf)
        nothing = Obstacles((), ())
        self._scene, self._whole = (
            scene_arrays(one, nothing, bodies=self.bodies)._replace(lower=-limits, upper=limits)
            for one in (replace(self.arm, touching=pairs), self.arm)
        )
        looked_at = [*self.bodies.centres, *self.bodies.corners, *self.ignored.centres, *self.ignored.corners]
        self._rows_at_once = max(1, _AT_ONCE // (self.arm.sphere_count * (1 + len(looked_at))))

    @property
    def names(self) -> tuple[str, ...]:
        kinds = ("box", "cylinder", "sphere", "mesh")
        return tuple(one.name for kind in kinds for one in self.known.scene if getattr(one, kind) is not None)

    def free(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """Which of (N, d) rad touch no known body, and nothing of the arm with what is attached to it."""
        return self._in_parts(
            lambda rows: KERNELS.free_batch(rows, self._scene), configurations, check_cancelled
        )

    def certain(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free of known bodies and the arm, all that moves in volumes to ignore."""
        if not self.known.ignore:
            return np.zeros(len(configurations), dtype=np.bool_)
        arrays = arm_arrays(self.arm)
        moving = arrays.links > _STILL

        def is_certain(rows: NDArray[np.float64]) -> NDArray[np.bool_]:
            centres = sphere_centres_batch(rows, arrays)[:, moving]
            found: NDArray[np.bool_] = are_inside(centres, arrays.radii[moving], self.ignored)
            found[found] = KERNELS.free_batch(rows[found], self._whole)
            return found

        return self._in_parts(is_certain, configurations, check_cancelled)

    def _in_parts(
        self,
        check: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
        configurations: NDArray[np.floating],
        check_cancelled: CheckCancelled,
    ) -> NDArray[np.bool_]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        found = np.empty(len(rows), dtype=np.bool_)
        for first in range(0, len(rows), self._rows_at_once):
            some = slice(first, first + self._rows_at_once)
            found[some] = check(rows[some])
            check_cancelled()
        return found

    def explains(self, points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (N, 3) m of pictures are of a known body, by 2 cm, or lie in a volume to ignore."""
        points = np.ascontiguousarray(points_m)
        near = points_to_bodies(points, self.bodies, SLACK_M) <= SLACK_M
        return np.asarray(near | (points_to_bodies(points, self.ignored, 0.0) <= 0.0))

    def complete(
        self, image: NDArray[np.uint8], grid: GridBox, check_cancelled: CheckCancelled = lambda: None
    ) -> None:
        """Write what is known, in place, into what pictures show, (X, Y, Z, 2); ``seen`` stays without."""
        low = np.asarray(grid.low_m)
        for bodies, is_free in ((self.ignored, True), (self.bodies, False)):
            if not is_free:
                self.seen = image.copy()
            meshes_from = len(bodies.centres) - len(bodies.roots)
            for number in range(len(bodies.centres)):
                layers = len(image) if number < meshes_from else 1
                for first in range(0, len(image), layers):
                    write_body(image, low, grid.voxel_m, number, bodies, is_free, first, first + layers)
                    check_cancelled()

    @property
    def size_bytes(self) -> int:
        arrays: list[NDArray[Any]] = [*self.bodies, *self.ignored]
        arrays += [] if self.seen is None else [self.seen]
        return sum(int(array.nbytes) for array in arrays) + sum(map(len, self.known.meshes.values()))

    def contact(
        self, configuration: NDArray[np.floating], image: NDArray[np.uint8], grid: GridBox
    ) -> Contact | None:
        """What is in the way of a configuration (d,) rad: known, the arm, seen or unseen, or None."""
        centres = self.arm.sphere_centres_m([configuration])[0]
        return (
            self._known_contact(centres) or self._self_contact(centres) or self._unfree(centres, image, grid)
        )

    def _known_contact(self, centres: NDArray[np.float64]) -> Contact | None:
        arrays, names, best = arm_arrays(self.arm), self.names, None
        for number, name in enumerate(names):
            for part in np.flatnonzero(~self.bodies.exempt[:, number]):
                away, sphere = part_contact(self.bodies, arrays, centres, number, part, 0.0)
                if sphere >= 0 and (best is None or -away > best.depth_m):
                    best = Contact("known", self.arm.parts[part].name, name, vector(centres[sphere]), -away)
        return best

    def _self_contact(self, centres: NDArray[np.float64]) -> Contact | None:
        ranges = zip(self.arm.parts, self.arm.sphere_ranges().tolist(), strict=True)
        own = {part.name: slice(*span) for part, span in ranges}
        radii, overlaps, best = self.arm.spheres_m()[:, 3], arm_arrays(self.arm).overlaps, None
        for (one, other), overlap in zip(self.arm.touching, overlaps, strict=True):
            first, second = own[one], own[other]
            gaps = np.linalg.norm(centres[first, None] - centres[None, second], axis=2)
            gaps -= radii[first, None] + radii[second]
            deep = -float(gaps.min() + overlap)
            if deep >= 0.0 and (best is None or deep > best.depth_m):
                sphere = first.start + int(np.argmin(gaps) // gaps.shape[1])
                best = Contact("self", one, other, vector(centres[sphere]), deep)
        return best

    def _unfree(
        self, centres: NDArray[np.float64], image: NDArray[np.uint8], grid: GridBox
    ) -> Contact | None:
        links, radii = self.arm.sphere_links(), self.arm.spheres_m()[:, 3]
        moving = np.flatnonzero(links > _STILL)
        known = lookup(image, grid, centres[moving])
        deep = radii[moving] - known.distance_m
        at, kind, depth = int(np.argmax(deep)), "seen", float(deep.max())
        if depth < 0.0:
            unseen = np.where(known.unseen, radii[moving], 0.0)
            if not unseen.any():
                return None
            at, depth = int(np.argmax(unseen)), 0.0
            kind = _UNSEEN.get(int(known.codes[at]), "hidden")
        part = np.searchsorted(self.arm.sphere_ranges()[:, 1], moving[at], side="right")
        return Contact(kind, self.arm.parts[part].name, "", vector(centres[moving[at]]), depth)

    def _check_names(self, arm: SerialArm) -> None:
        parts = {part.name for part in arm.parts}
        bodies = {one.name for one in (*self.known.scene, *self.known.attached)}
        if both := sorted(bodies & (parts | {TOOL})):
            raise InputError(
                "a body has a part's name", expected="a name of its own", got=", ".join(both)[:200]
            )
        links = {name for one in self.known.attached for name in one.touch_links}
        names = {name for pair in self.known.allowed for name in pair} - bodies
        if unknown := sorted((links | names) - parts):
            raise InputError(
                "a link or body is unknown",
                expected=f"{', '.join(sorted(parts))}; for `allowed` also names of bodies"[:1000],
                got=", ".join(unknown)[:200],
            )

    def _holding(self, arm: SerialArm, meshes: Mapping[str, NDArray[np.float64]]) -> SerialArm:
        """The arm with what is attached to it, and without the pairs that may touch."""
        allowed = {frozenset(pair) for pair in self.known.allowed}
        parts, touching = list(arm.parts), [pair for pair in arm.touching if frozenset(pair) not in allowed]
        left = MAX_SPHERES - arm.sphere_count
        for one in self.known.attached:
            link, frame = arm.named_frame(one.link)
            spheres = cover(one, meshes, min(_MOST_SPHERES, left // len(self.known.attached)))
            spheres[:, :3] = moved(frame @ one.matrix, spheres[:, :3])
            parts.append(Part(one.name, link, tuple(tuple(row) for row in spheres.tolist())))
            may_touch = set(one.touch_links) | {name for pair in allowed if one.name in pair for name in pair}
            touching += [
                (one.name, part.name)
                for part in parts[:-1]
                if part.link != link and part.name not in may_touch
            ]
        return replace(arm, parts=tuple(parts), touching=tuple(touching))


def bodies_of(bodies: Iterable[Body], meshes: Mapping[str, NDArray[np.float64]]) -> BodyArrays:
    """The arrays of bodies; meshes are corners (T, 3, 3) by file, in their own unit."""
    boxes, cylinders, spheres, triangles = [], [], [], []
    for one in bodies:
        pose = one.matrix
        if one.box is not None:
            boxes.append(kernel_row(pose, np.asarray(one.box.size_m) / 2.0))
        elif one.cylinder is not None:
            cylinders.append(kernel_row(pose, (one.cylinder.radius_m, one.cylinder.length_m / 2.0)))
        elif one.sphere is not None:
            spheres.append((*pose[:3, 3], one.sphere.radius_m))
        elif one.mesh is not None:
            triangles.append(moved(pose, meshes[one.mesh.file] * one.mesh.scale))
    return body_arrays(boxes, cylinders, spheres, triangles)


def cover(
    body: Body, meshes: Mapping[str, NDArray[np.float64]], most: int = _MOST_SPHERES
) -> NDArray[np.float64]:
    """Spheres (S, 4) in a body's own frame, at most so many, that cover it near its surface, to 3 mm."""
    if body.sphere is not None:
        return np.array([[0.0, 0.0, 0.0, body.sphere.radius_m]])
    own = bodies_of([replace(body, pose=HERE)], meshes)
    # Of a mesh, a box or a cylinder, of which there is one.
    corners = own.corners.reshape(-1, 3)
    if not len(corners):
        half = own.boxes[0, 12:15] if len(own.boxes) else own.cylinders[0, [12, 12, 13]]
        corners = np.stack([-half, half])
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y, z = high - low
    # Not far below the side at which so many squares cover the box round the body.
    cell_m = max(_CELL_M, 0.7 * float(np.sqrt(2.0 * (x * y + y * z + z * x) / most)))
    while len(found := _cells(own, low, high, cell_m, most)) > most:
        cell_m *= _COARSER
    return found


def _cells(
    own: BodyArrays, low: NDArray[np.float64], high: NDArray[np.float64], cell_m: float, most: int
) -> NDArray[np.float64]:
    """Spheres (S, 4), one for each cell of about such a side that the body's surface is near to."""
    counts = np.maximum(np.ceil((high - low) / cell_m), 1).astype(np.int64)
    if counts.prod() > _MOST_CELLS:
        # Too many to be looked at are too many to be spheres.
        return np.empty((most + 1, 4))
    side = np.maximum(high - low, 1e-6) / counts
    index = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    half = float(np.linalg.norm(side)) / 2.0
    away = points_to_bodies(low + (index + 0.5) * side, own, half)
    # Of thin bodies less is left bare.
    bare_m = min(_BARE_M, max(0.0, -float(away.min())) / 2.0)
    # Deep inside nothing comes but through the surface.
    index = index[(away <= half) & (away > -half - side.max())]
    if len(index) > most:
        return np.empty((len(index), 4))
    parts = np.stack(np.meshgrid(*[np.arange(_PARTS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + (index[:, None] + (parts + 0.5) / _PARTS) * side
    reach = half / _PARTS
    away = points_to_bodies(points.reshape(-1, 3), own, 2.0 * reach).reshape(points.shape[:2])
    held = away <= reach - bare_m
    points, held = points[held.any(axis=1)], held[held.any(axis=1)][..., None]
    first = np.where(held, points, np.inf).min(axis=1)
    last = np.where(held, points, -np.inf).max(axis=1)
    middle = (first + last) / 2.0
    spheres = _least_out(own, middle, points, held[..., 0], half)
    spheres[:, 3] += reach
    return spheres


def _least_out(
    own: BodyArrays,
    middle: NDArray[np.float64],
    points: NDArray[np.float64],
    held: NDArray[np.bool_],
    half: float,
) -> NDArray[np.float64]:
    """Spheres (S, 4) about those of points (S, N, 3) that are held, moved inwards: large spheres are flat."""
    ahead = (middle[:, None, None] + half / 4.0 * np.stack([np.eye(3), -np.eye(3)], axis=1)).reshape(-1, 3)
    slope = np.diff(points_to_bodies(ahead, own, 2.0 * half).reshape(-1, 3, 2), axis=2)[..., 0]
    inwards = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)
    best, least = np.empty((len(middle), 4)), np.full(len(middle), np.inf)
    for step in _INWARDS:
        centres = middle + step * half * inwards
        radii = np.where(held, np.linalg.norm(points - centres[:, None], axis=2), 0.0).max(axis=1)
        out = radii + points_to_bodies(centres, own, 2.0 * half)
        best[out < least] = np.column_stack([centres, radii])[out < least]
        least = np.minimum(least, out)
    return best


def load_kernels(world: Any) -> None:
    """Have the compiled code in this process."""
    box = BoxShape((0.1, 0.1, 0.1))
    known = PlanningScene((Body("box", box),), (Attached("held", box),), ignore=(Body("free", box),))
    made = SceneChecker(world.body, known)
    made.explains(np.zeros((1, 3)))
    made.complete(np.zeros(world.sensor.picture_shape, dtype=np.uint8), world.sensor.grid)
    made.free(np.zeros((1, world.dim)))
    made.certain(np.zeros((1, world.dim)))
    made.contact(np.zeros(world.dim), np.zeros(world.sensor.picture_shape, dtype=np.uint8), world.sensor.grid)
