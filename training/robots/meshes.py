"""Triangle meshes of the shapes that collide, with how deep points lie in them.

Inside is where the winding number of the surface is above a half (Jacobson, Kavan and Sorkine-Hornung 2013),
so that meshes with small holes have an inside too.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.kernel_cache import njit
from cspace.worlds.spatial.poses import moved

Floats = NDArray[np.float64]
_FACETS = 48
_MAX_EDGE_POINTS = 200_000
_MAX_FILE_BYTES = 64_000_000
_MAX_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A closed surface of triangles.

    Args:
        corners: (T, 3, 3) corners of each triangle, m.
    """

    corners: Floats

    def moved(self, frame: Floats) -> "Mesh":
        """The same in a frame (4, 4)."""
        return Mesh(moved(frame, self.corners))

    def depth_m(self, points: Floats) -> Floats:
        """Distance of each of (N, 3) to the surface, (N,) m; negative outside."""
        result: Floats = _depths(np.ascontiguousarray(points), np.ascontiguousarray(self.corners))
        return result

    @property
    def areas_m2(self) -> Floats:
        """Area of each triangle, (T,)."""
        first, second, third = (self.corners[:, index] for index in range(3))
        return np.asarray(np.linalg.norm(np.cross(second - first, third - first), axis=1) / 2.0)

    def surface(self, spacing_m: float, rng: np.random.Generator) -> Floats:
        """Points on the surface, one per square of that spacing and as many along edges, (N, 3) m."""
        first, second, third = (self.corners[:, index] for index in range(3))
        areas = self.areas_m2
        count = int(np.ceil(areas.sum() / spacing_m**2))
        chosen = rng.choice(len(areas), size=count, p=areas / areas.sum())
        u, v = rng.random((2, count, 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        drawn = first[chosen] + u * (second - first)[chosen] + v * (third - first)[chosen]
        return np.concatenate([drawn, self._edges(spacing_m)])

    def _edges(self, spacing_m: float) -> Floats:
        """Points along all edges, so far apart at most, (N, 3) m; farther where they are very long."""
        starts, ends = self.corners.reshape(-1, 3), np.roll(self.corners, -1, axis=1).reshape(-1, 3)
        lengths = np.linalg.norm(ends - starts, axis=1)
        spacing_m = max(spacing_m, float(lengths.sum()) / _MAX_EDGE_POINTS)
        steps = np.ceil(lengths / spacing_m).astype(np.int64)
        edge = np.repeat(np.arange(len(starts)), steps)
        step = np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)
        points = starts[edge] + (step / steps[edge])[:, None] * (ends - starts)[edge]
        return np.unique(np.round(points, 6), axis=0)


def box_mesh(sides: Floats) -> Mesh:
    """A box round the origin."""
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * sides
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return Mesh(corners[np.asarray(faces)])


def cylinder_mesh(radius_m: float, length_m: float) -> Mesh:
    """A cylinder round the z axis and the origin."""
    angles = np.linspace(0.0, 2.0 * np.pi, _FACETS, endpoint=False)
    # Facets outside the circle, for the whole cylinder to be covered.
    ring = radius_m / np.cos(np.pi / _FACETS) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    low, high = (np.column_stack([ring, np.full(_FACETS, z)]) for z in (-length_m / 2.0, length_m / 2.0))
    after_low, after_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    bottom, top = (np.broadcast_to([0.0, 0.0, z], low.shape) for z in (-length_m / 2.0, length_m / 2.0))
    triangles = [(low, after_low, after_high), (low, after_high, high)]
    triangles += [(bottom, after_low, low), (top, high, after_high)]
    return Mesh(np.concatenate([np.stack(corners, axis=1) for corners in triangles]))


def sphere_mesh(radius_m: float) -> Mesh:
    """A sphere round the origin."""
    rows = _FACETS // 2
    polar = np.linspace(0.0, np.pi, rows + 1)[:, None]
    round_ = np.linspace(0.0, 2.0 * np.pi, _FACETS + 1)[None]
    grid = radius_m * np.stack(
        [np.sin(polar) * np.cos(round_), np.sin(polar) * np.sin(round_), np.cos(polar) + 0.0 * round_],
        axis=-1,
    )
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return Mesh(np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))]))


def file_mesh(path: Path, scale: Floats) -> Mesh:
    """The mesh in a file; coal reads STL, OBJ, DAE and more.

    Raises:
        ScenarioError: coal is not installed or cannot read the file, or file or mesh are too large.
    """
    from training.robots.mesh_files import load_triangles  # noqa: PLC0415 # primitives need no coal

    size = path.stat().st_size
    if size > _MAX_FILE_BYTES:
        raise ScenarioError(
            "a mesh is too large",
            expected=f"at most {_MAX_FILE_BYTES // 1_000_000} MB",
            got=f"{path}: {size}",
        )
    mesh = Mesh(load_triangles(path) * scale)
    reach = float(np.abs(mesh.corners).max())
    if not (reach <= _MAX_M and mesh.areas_m2.sum() > 0.0):
        raise ScenarioError(
            "a mesh does not fit",
            expected=f"triangles within {_MAX_M:g} m, after they are scaled",
            got=f"{path} with the scale {scale.tolist()} reaches {reach:g} m",
        )
    return mesh


@njit(cache=True, nogil=True)
def _depths(points, corners):  # type: ignore[no-untyped-def]
    out = np.empty(points.shape[0])
    for row in range(points.shape[0]):
        x, y, z = points[row]
        least, winding = np.inf, 0.0
        for index in range(corners.shape[0]):
            a, b, c = corners[index]
            ax, ay, az, bx, by, bz = a[0] - x, a[1] - y, a[2] - z, b[0] - x, b[1] - y, b[2] - z
            cx, cy, cz = c[0] - x, c[1] - y, c[2] - z
            least = min(least, _triangle(ax, ay, az, bx, by, bz, cx, cy, cz))
            la, lb = np.sqrt(ax * ax + ay * ay + az * az), np.sqrt(bx * bx + by * by + bz * bz)
            lc = np.sqrt(cx * cx + cy * cy + cz * cz)
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            ab, bc = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz
            ca = cx * ax + cy * ay + cz * az
            winding += np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        out[row] = np.sqrt(least) * (1.0 if abs(winding) > np.pi else -1.0)
    return out


@njit(cache=True, nogil=True)
def _triangle(ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    """Squared distance of the origin to a triangle."""
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    if area > 0.0:
        # Barycentric coordinates of the origin's foot on the plane, times the area.
        wx, wy, wz = -ax, -ay, -az
        t = (uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz
        s = (wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz
        if s >= 0.0 and t >= 0.0 and s + t <= area:
            height = wx * nx + wy * ny + wz * nz
            return height * height / area
    first = _segment(ax, ay, az, ux, uy, uz)
    second = _segment(ax, ay, az, vx, vy, vz)
    return min(first, second, _segment(bx, by, bz, cx - bx, cy - by, cz - bz))


@njit(cache=True, nogil=True)
def _segment(ax, ay, az, ux, uy, uz):  # type: ignore[no-untyped-def]
    """Squared distance of the origin to the segment from a to a + u."""
    square = ux * ux + uy * uy + uz * uz
    along = 0.0
    if square > 0.0:
        along = min(1.0, max(0.0, -(ax * ux + ay * uy + az * uz) / square))
    x, y, z = ax + along * ux, ay + along * uy, az + along * uz
    return x * x + y * y + z * z
