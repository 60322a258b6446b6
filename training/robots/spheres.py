"""Few spheres that cover a link's shapes and stick out little.

Shapes are read by trimesh as solids of triangles. How deep points lie in them is libigl's: inside is where
the winding number of the surface is above a half (Jacobson, Kavan and Sorkine-Hornung 2013, Barill et al.
2018), so that meshes with holes have an inside too.

A sphere round c sticks out by no more than m where its radius is at most the depth of c plus m. So each
point of a grid through the solid and the shell of m / 2 around it offers that sphere, and so do points that
no such sphere reaches, with others about them. A greedy set cover (Chvatal 1979) chooses among them until all
points of the surface and of the inside are within the slack, also those that are sampled afresh.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from cspace.errors import ScenarioError
from training.robots.description import found_file, read_file

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
# No arm has smaller or larger parts.
MIN_SIZE_M, MAX_SIZE_M, _MAX_REACH_M = 1e-4, 10.0, 100.0
_FACETS = 48
_FORMATS = ("dae", "obj", "ply", "stl")
# Of the excess, for numbers that are written short.
_ROUNDED_M = 2e-5
# Of the slack, for what lies between the points that are looked at; the part of it that may be used up.
_RESERVE_M, _USED_M = 0.0003, 0.0002
_SURFACE_POINTS = 2000
_FRESH_POINTS = 20_000
_INSIDE_POINTS = 500
_DEPTH_POINTS = 4000
# Of one shape, if each covers a disc of its size on both sides of a wall.
_MANY_SPHERES = 300
_GRID_POINTS = 24_000
# Points that become centres at a time, with so many others about each.
_MORE_POINTS, _AROUND = 400, 6
_PASSES = 40
# Of points and spheres, whose distances are computed at a time.
_PAIRS = 4_000_000


class Solid:
    """A surface of triangles, m, with an inside; ``sphere`` is its centre and radius (4,) if it is one."""

    def __init__(self, mesh: Any, sphere: Floats | None = None) -> None:
        self.sphere = sphere
        self.mesh = mesh
        self._vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
        self._faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
        self._tree = igl.AABB()
        self._tree.init(self._vertices, self._faces)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Which of (N, 3) lie inside, (N,)."""
        inside = ((points >= self.mesh.bounds[0]) & (points <= self.mesh.bounds[1])).all(axis=1)
        if inside.any():
            inside[inside] = (
                np.abs(igl.fast_winding_number(self._vertices, self._faces, points[inside])) > 0.5
            )
        return np.asarray(inside)

    def depth_m(self, points: Floats) -> Floats:
        """Distance of each of (N, 3) to the surface, (N,) m; negative outside."""
        points = np.ascontiguousarray(points)
        squares = self._tree.squared_distance(self._vertices, self._faces, points)[0]
        return np.asarray(np.sqrt(squares) * np.where(self.contains(points), 1.0, -1.0))

    def surface(self, count: int, rng: np.random.Generator) -> Floats:
        """Points of its triangles, as many of its edges, and no more of its corners, (N, 3) m."""
        points = [np.asarray(trimesh.sample.sample_surface(self.mesh, count, seed=rng)[0])]
        edges = self.mesh.vertices[self.mesh.edges_unique]
        lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
        chosen, part = rng.choice(len(edges), count, p=lengths / lengths.sum()), rng.random((count, 1))
        points.append(edges[chosen, 0] + part * (edges[chosen, 1] - edges[chosen, 0]))
        points.append(rng.permutation(self._vertices)[:count])
        return np.concatenate(points)

    def is_hollow(self, excess_m: float, rng: np.random.Generator) -> bool:
        """Whether hundreds of spheres are needed, as none inside is much larger than the excess."""
        low, high = self.mesh.bounds
        points = rng.uniform(low, high, (_DEPTH_POINTS, 3))
        radius_m = max(0.0, float(self.depth_m(points).max())) + excess_m
        return bool(self.mesh.area / (2.0 * np.pi * radius_m**2) > _MANY_SPHERES)

    def hull(self) -> "Solid":
        """The convex hull."""
        return Solid(self.mesh.convex_hull)


def union_depth_m(solids: Sequence[Solid], points: Floats) -> Floats:
    """Depth of each of (N, 3) in the union of solids, (N,) m; negative outside, and no deeper than in one."""
    return np.asarray(np.max([solid.depth_m(points) for solid in solids], axis=0))


def union_surface(solids: Sequence[Solid], count: int, rng: np.random.Generator) -> Floats:
    """Points of the surfaces of solids, also inside of others, (N, 3) m; ``count`` shared out by area."""
    area = sum(solid.mesh.area for solid in solids)
    shares = [max(20, int(np.ceil(count * solid.mesh.area / area))) for solid in solids]
    return np.concatenate([one.surface(share, rng) for one, share in zip(solids, shares, strict=True)])


def read_solids(
    shapes: Iterable[Any], where: str, folder: Path, packages: Mapping[str, Path]
) -> tuple[list[Solid], list[str]]:
    """The solids of a link's shapes, as yourdfpy reads them, in the frame of the link, and warnings."""
    solids, notes = [], []
    for shape in shapes:
        kind, sizes = _sizes(shape.geometry)
        if not np.any(sizes):
            notes.append(f"a {kind} of {where} has no size and is left out")
            continue
        if kind == "mesh":
            mesh = load_mesh(found_file(shape.geometry.mesh.filename, folder, packages), sizes, where)
        else:
            mesh = _primitive(kind, sizes, where)
        if shape.origin is not None:
            mesh.apply_transform(shape.origin)
        reach_m = float(np.abs(mesh.bounds).max())
        if not (reach_m <= _MAX_REACH_M and mesh.area > 0.0):
            raise ScenarioError(
                f"a {kind} of {where} does not fit",
                expected=f"triangles within {_MAX_REACH_M:g} m of the link",
                got=f"{reach_m:g} m with the sizes, or the scale, {sizes.tolist()}",
            )
        sphere = np.append(mesh.bounds.mean(axis=0), sizes) if kind == "sphere" else None
        solids.append(Solid(mesh, sphere))
    return solids, notes


def _sizes(geometry: Any) -> tuple[str, Floats]:
    for kind, keys in (("box", ("size",)), ("cylinder", ("radius", "length")), ("sphere", ("radius",))):
        if (found := getattr(geometry, kind)) is not None:
            return kind, np.hstack([getattr(found, key) for key in keys])
    scale = geometry.mesh.scale
    return "mesh", np.ones(3) * (1.0 if scale is None else scale)


def _primitive(kind: str, sizes: Floats, where: str) -> Any:
    count = {"box": 3, "cylinder": 2, "sphere": 1}[kind]
    if not (len(sizes) == count and sizes.min() >= MIN_SIZE_M and sizes.max() <= MAX_SIZE_M):
        raise ScenarioError(
            f"a shape of {where} does not fit",
            expected=f"a {kind} with sizes from {MIN_SIZE_M:g} to {MAX_SIZE_M:g} m",
            got=str(sizes.tolist()),
        )
    if kind == "box":
        return trimesh.creation.box(extents=sizes)
    if kind == "sphere":
        return trimesh.creation.icosphere(subdivisions=4, radius=sizes[0])
    # Facets outside the circle, for the whole cylinder to be covered.
    radius = sizes[0] / np.cos(np.pi / _FACETS)
    return trimesh.creation.cylinder(radius=radius, height=sizes[1], sections=_FACETS)


def load_mesh(path: Path, scale: Floats, where: str) -> Any:
    """All triangles of a mesh file, of all its nodes and materials, in m; a negative scale mirrors.

    Other files that it names, as textures and materials, are not read.
    """
    data = read_file(path)
    try:
        kind = path.suffix.lower().removeprefix(".")
        if kind not in _FORMATS:
            raise ValueError(kind)  # noqa: TRY301
        # Of bytes, so that the reader has no folder to look for other files in.
        scene = trimesh.load_scene(BytesIO(data), file_type=kind, process=False, skip_materials=True)
        mesh = scene.to_mesh()
        unit = mesh.units or scene.units
        metres = 1.0 if unit is None else trimesh.units.unit_conversion(unit, "meters")
        mesh = trimesh.Trimesh(mesh.vertices * metres * scale, mesh.faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces())
        # Corners of no triangle lie anywhere.
        mesh.remove_unreferenced_vertices()
        if len(mesh.faces):
            return mesh
        got = "no triangles"
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - readers of strangers' bytes raise whatever they meet
        got = repr(error)
    raise ScenarioError(
        f"a mesh of {where} cannot be read", expected=", ".join(_FORMATS), got=f"{path}: {got}"[:300]
    )


@dataclass(frozen=True, slots=True)
class Allowances:
    """How far points of a surface may lie outside all spheres, and how far spheres may stick out, m.

    If ``relaxed``, spheres of parts longer than 0.8 m may stick out more, by 3 % of the excess length.
    """

    slack_m: float = 0.002
    excess_m: float = 0.010
    relaxed: bool = True

    def of(self, solids: Sequence[Solid]) -> "Allowances":
        """The allowances of a part."""
        bounds = np.stack([solid.mesh.bounds for solid in solids])
        diagonal = float(np.linalg.norm(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))
        return replace(self, excess_m=self.excess_m + self.relaxed * 0.03 * max(0.0, diagonal - 0.8))

    def __post_init__(self) -> None:
        if not all(0.001 <= one <= 1.0 for one in (self.slack_m, self.excess_m)):
            raise ScenarioError(
                "the allowances do not fit",
                expected="0.001 m or more, and at most 1 m",
                got=f"{self.slack_m}, {self.excess_m}",
            )


@dataclass(frozen=True, slots=True)
class Fit:
    """How many spheres there are, what they miss of the surface and what sticks out."""

    spheres: int
    missed_m: float
    excess_m: float


class _Candidates:
    """Spheres to choose from, and which of some points each covers."""

    def __init__(self, solids: Sequence[Solid], allowances: Allowances, rng: np.random.Generator) -> None:
        self._solids, self._allowances, self._rng = solids, allowances, rng
        self._spheres = self._sound(_grid(solids, allowances.excess_m / 2.0))
        inside = self._spheres[self._spheres[:, 3] > allowances.excess_m, :3]
        some = rng.permutation(inside)[:_INSIDE_POINTS]
        self.points = np.concatenate([union_surface(solids, _SURFACE_POINTS, rng), some])
        self.covered = self.covers(self.points)
        self._reach()

    def spheres(self, chosen: Indices) -> Floats:
        return self._spheres[chosen]

    def covers(self, points: Floats, chosen: Indices | slice = slice(None)) -> Flags:
        """Which points lie in which spheres, (N, K)."""
        spheres, more_m = self._spheres[chosen], self._allowances.slack_m - _RESERVE_M
        blocks = np.array_split(points, 1 + len(points) * len(spheres) // _PAIRS)
        return np.concatenate([cdist(one, spheres[:, :3]) <= spheres[:, 3] + more_m for one in blocks])

    def add(self, points: Floats) -> None:
        """Take more points that have to be covered."""
        self.covered = np.concatenate([self.covered, self.covers(points)])
        self.points = np.concatenate([self.points, points])
        self._reach()

    def _reach(self) -> None:
        """Take more spheres until each point is in one."""
        left = np.inf
        while len(far := self.points[~self.covered.any(axis=1)]):
            if len(far) == left:
                raise ScenarioError(
                    "a shape cannot be covered by spheres",
                    expected="triangles that lie where their points do",
                    got=f"points that no sphere reaches, as {far[0].tolist()}",
                )
            left = len(far)
            far = self._rng.permutation(far)[:_MORE_POINTS]
            steps = self._rng.normal(scale=self._allowances.excess_m, size=(len(far), _AROUND, 3))
            about = (far[:, None] + steps).reshape(-1, 3)
            first = len(self._spheres)
            self._spheres = np.concatenate([self._spheres, self._sound(about), self._sound(far)])
            more = self.covers(self.points, slice(first, None))
            self.covered = np.concatenate([self.covered, more], axis=1)

    def _sound(self, centres: Floats) -> Floats:
        """The spheres round centres that are not too far outside."""
        depths = union_depth_m(self._solids, centres)
        rows = np.column_stack([centres, depths + self._allowances.excess_m - _ROUNDED_M])
        return np.asarray(rows[depths > -self._allowances.excess_m / 2.0])


def cover(solids: Sequence[Solid], allowances: Allowances, rng: np.random.Generator) -> Floats:
    """Centres and radii of spheres that cover a union of solids, (K, 4) m."""
    candidates = _Candidates(solids, allowances, rng)
    chosen = np.empty(0, dtype=np.int64)
    for _ in range(_PASSES):
        chosen = _without_needless(candidates.covered, _completed(candidates.covered, chosen))
        spheres = candidates.spheres(chosen)
        fresh = union_surface(solids, _FRESH_POINTS, rng)
        gaps = gaps_m(fresh, spheres)
        if gaps.max() <= allowances.slack_m - _RESERVE_M + _USED_M:
            break
        candidates.add(fresh[gaps > allowances.slack_m - _RESERVE_M])
    return spheres


def measure(solids: Sequence[Solid], spheres: Floats, rng: np.random.Generator) -> Fit:
    """How well spheres (K, 4) cover a union of solids."""
    missed = gaps_m(union_surface(solids, _FRESH_POINTS, rng), spheres)
    directions = rng.normal(size=(len(spheres), 400, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    shells = (spheres[:, None, :3] + spheres[:, None, 3:] * directions).reshape(-1, 3)
    shells = shells[gaps_m(shells, spheres) > -1e-9]
    excess = np.maximum(-union_depth_m(solids, shells), 0.0)
    return Fit(len(spheres), float(missed.max()), float(excess.max()))


def gaps_m(points: Floats, spheres: Floats) -> Floats:
    """Signed distances of points (N, 3) to the union of spheres (K, 4), (N,) m."""
    blocks = np.array_split(points, 1 + len(points) * len(spheres) // _PAIRS)
    return np.concatenate([(cdist(one, spheres[:, :3]) - spheres[:, 3]).min(axis=1) for one in blocks])


def _grid(solids: Sequence[Solid], margin_m: float) -> Floats:
    bounds = np.stack([solid.mesh.bounds for solid in solids])
    low, high = bounds[:, 0].min(axis=0) - margin_m, bounds[:, 1].max(axis=0) + margin_m
    spacing = float(np.cbrt(np.prod(high - low) / _GRID_POINTS))
    axes = [
        np.linspace(a, b, max(3, int(np.ceil((b - a) / spacing)))) for a, b in zip(low, high, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _completed(covered: Flags, chosen: Indices) -> Indices:
    """Chosen spheres, with those that greed adds until every point is covered."""
    left = covered[~covered[:, chosen].any(axis=1)]
    counts = left.sum(axis=0, dtype=np.int32)
    added = list(chosen)
    while len(left):
        best = int(np.argmax(counts))
        gone = left[:, best]
        counts -= left[gone].sum(axis=0, dtype=np.int32)
        left = left[~gone]
        added.append(best)
    return np.asarray(added, dtype=np.int64)


def _without_needless(covered: Flags, chosen: Indices) -> Indices:
    """Chosen spheres without those whose points the others cover, small ones first."""
    table = covered[:, chosen]
    times, kept = table.sum(axis=1), np.ones(len(chosen), dtype=np.bool_)
    for one in np.argsort(table.sum(axis=0)):
        if (times[table[:, one]] > 1).all():
            times -= table[:, one]
            kept[one] = False
    return chosen[kept]
