"""Solids of triangles, read by trimesh, with how deep points lie in them, by libigl.

Inside is where the winding number of the surface is above a half (Jacobson, Kavan and Sorkine-Hornung 2013,
Barill et al. 2018), so that meshes with holes have an inside too.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.files import read_bounded
from training.robots.description import read_xml
from training.robots.packages import package_of, package_roots

Floats = NDArray[np.float64]
# No arm has smaller or larger parts.
MIN_SIZE_M, MAX_SIZE_M = 1e-4, 10.0
_FACETS = 48
_FORMATS = {kind: kind for kind in ("dae", "obj", "ply", "stl")}
_MAX_FILE_BYTES = 64_000_000
_MAX_M = 100.0
_MAX_NAME = 250
_PACKAGE, _FILE = "package://", "file://"


class Solid:
    """A surface of triangles with an inside.

    Args:
        mesh: the triangles, m.
        sphere: (4,) centre and radius, where it is one.
    """

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
    """The solids of a link's shapes, as yourdfpy reads them, in the frame of the link, and warnings.

    Raises:
        ScenarioError: a mesh is not found or cannot be read, or a size does not fit.
    """
    solids, notes = [], []
    for shape in shapes:
        kind, sizes = _sizes(shape.geometry)
        if not np.any(sizes):
            notes.append(f"a {kind} of {where} has no size and is left out")
            continue
        if kind != "mesh" and not (sizes.min() >= MIN_SIZE_M and sizes.max() <= MAX_SIZE_M):
            raise ScenarioError(
                f"a shape of {where} does not fit",
                expected=f"a {kind} with sizes from {MIN_SIZE_M:g} to {MAX_SIZE_M:g} m",
                got=str(sizes.tolist()),
            )
        if kind == "mesh":
            mesh = load_mesh(found_file(shape.geometry.mesh.filename, folder, packages), sizes, where)
        elif kind == "box":
            mesh = trimesh.creation.box(extents=sizes)
        elif kind == "cylinder":
            # Facets outside the circle, for the whole cylinder to be covered.
            radius = sizes[0] / np.cos(np.pi / _FACETS)
            mesh = trimesh.creation.cylinder(radius=radius, height=sizes[1], sections=_FACETS)
        else:
            mesh = trimesh.creation.icosphere(subdivisions=4, radius=sizes[0])
        if shape.origin is not None:
            mesh.apply_transform(shape.origin)
        sphere = np.append(mesh.bounds.mean(axis=0), sizes) if kind == "sphere" else None
        solids.append(Solid(mesh, sphere))
    return solids, notes


def _sizes(geometry: Any) -> tuple[str, Floats]:
    for kind, keys in (("box", ("size",)), ("cylinder", ("radius", "length")), ("sphere", ("radius",))):
        if (found := getattr(geometry, kind)) is not None:
            return kind, np.hstack([getattr(found, key) for key in keys])
    scale = geometry.mesh.scale
    return "mesh", np.ones(3) * (1.0 if scale is None else scale)


def load_mesh(path: Path, scale: Floats, where: str) -> Any:
    """All triangles of a mesh file, of all its nodes and materials, in m; a negative scale mirrors.

    Other files that it names, as textures and materials, are not read.

    Raises:
        ScenarioError: it is too large, it cannot be read, or it has no triangles within 100 m.
    """
    data = read_bounded(path, _MAX_FILE_BYTES, ScenarioError)
    kind = path.suffix.lower().removeprefix(".")
    root = read_xml(data, path.name, "COLLADA") if kind == "dae" else None
    try:
        if root is not None:
            _check_size(root)
        with warnings.catch_warnings():
            # NumPy warns of numbers after which it stops.
            warnings.simplefilter("error", DeprecationWarning)
            scene = trimesh.load_scene(
                BytesIO(data), file_type=_FORMATS[kind], process=False, skip_materials=True
            )
        mesh = scene.to_mesh()
        unit = mesh.units or scene.units
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        vertices = vertices * (1.0 if unit is None else trimesh.units.unit_conversion(unit, "meters"))
        mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
        sound = len(mesh.faces) and mesh.faces.min() >= 0 and mesh.faces.max() < len(vertices)
        reach = float(np.abs(vertices * scale).max()) if sound else np.nan
        if reach <= _MAX_M:
            mesh.apply_transform(np.diag([*scale, 1.0]))
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            mesh.update_faces(mesh.nondegenerate_faces())
            # Corners of no triangle lie anywhere.
            mesh.remove_unreferenced_vertices()
    except MemoryError:
        raise
    except Exception as error:  # readers of strangers' bytes raise whatever they meet
        raise ScenarioError(
            f"a mesh of {where} cannot be read", expected=", ".join(_FORMATS), got=f"{path}: {error!r}"[:300]
        ) from error
    if not (reach <= _MAX_M and mesh.area > 0.0):
        raise ScenarioError(
            f"a mesh of {where} does not fit",
            expected=f"triangles within {_MAX_M:g} m, after they are scaled",
            got=f"{path} with the scale {scale.tolist()} reaches {reach:g} m",
        )
    return mesh


def _check_size(root: Any) -> None:
    """Check that a COLLADA file does not grow where it is read, for pycollada does as it says.

    Polygons have as many corners as there are, and with all instances it is no larger than a file may be.

    Raises:
        ValueError: it grows.
    """
    for one in root.iter("{*}polylist"):
        offsets = [int(row.get("offset", 0)) for row in one.iterfind("{*}input")]
        corners, indices = (
            np.fromstring(one.findtext(tag, ""), np.int64, sep=" ") for tag in ("{*}vcount", "{*}p")
        )
        stride, most = max(offsets, default=0) + 1, len(indices)
        if not 0 <= corners.min(initial=0) <= corners.max(initial=0) <= most == stride * corners.sum():
            raise ValueError(f"polygons of {corners.sum()} corners, and {most} indices")
    named: dict[str | None, list[Any]] = {}
    for one in root.iter("{*}node", "{*}geometry"):
        named.setdefault(one.get("id"), []).append(one)
    sizes: dict[Any, float] = {}

    def size(one: Any) -> float:
        if one not in sizes:
            # Of what holds itself.
            sizes[one] = np.inf
            instances = named.get((one.get("url") or "").removeprefix("#"), [])
            sizes[one] = 1 + len(one.text or "") + sum(map(size, [*one, *instances]))
        return sizes[one]

    if sum(map(size, root.iter("{*}visual_scene"))) > _MAX_FILE_BYTES:
        raise ValueError(
            f"nodes that hold others, or themselves, more than {_MAX_FILE_BYTES} characters in all"
        )


def found_file(name: str | None, folder: Path, packages: Mapping[str, Path]) -> Path:
    """The file that a description names: in its package, in its folder, or in a package that is given.

    A package is looked for among those given, else in the folders above the description.

    Raises:
        ScenarioError: there is none, or it lies elsewhere, also by a symbolic link.
    """
    name = unquote(name or "")
    if name.startswith(_PACKAGE):
        package, _, rest = name.removeprefix(_PACKAGE).partition("/")
        places: list[tuple[Path, tuple[Path, ...]]]
        places = [(root / rest, (root,)) for root in package_roots(package, folder, packages)]
        remedy = f"say where the package lies with --package {package}=FOLDER"
    else:
        places = [(folder / name.removeprefix(_FILE), (package_of(folder), *packages.values()))]
        remedy = "put the mesh where the description names it"
    for place, within in [] if "\0" in name or len(name) > _MAX_NAME else places:
        if not place.is_file():
            continue
        real = place.resolve()
        if any(real.is_relative_to(root.resolve()) for root in within):
            return place
        raise ScenarioError(
            "a mesh lies outside the robot's folder",
            expected=f"a file in {' or '.join(str(root) for root in within)}",
            got=str(real),
            remedy="copy it there, or name the folder that holds it with --package NAME=FOLDER",
        )
    raise ScenarioError(
        "a mesh is not found", expected=f"a file at {name[:200]}", got=f"none from {folder}", remedy=remedy
    )
