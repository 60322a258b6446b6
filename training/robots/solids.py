"""The meshes of a piece of the robot, its primitives turned into such."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from cspace.errors import ScenarioError
from training.robots.chain import Piece
from training.robots.meshes import Mesh, box_mesh, cylinder_mesh, file_mesh, sphere_mesh
from training.robots.urdf import Shape

_PACKAGE, _FILE = "package://", "file://"


def solid_of(piece: Piece, folder: Path, packages: Mapping[str, Path]) -> tuple[Mesh, ...]:
    """The meshes of a piece, in the frame of the arm's link that it is fixed to.

    Args:
        piece: of the chain.
        folder: where the description lies.
        packages: folders of packages by their names.

    Raises:
        ScenarioError: a mesh is not found or cannot be read.
    """
    return tuple(_mesh(shape, folder, packages).moved(shape.frame) for shape in piece.shapes)


def _mesh(shape: Shape, folder: Path, packages: Mapping[str, Path]) -> Mesh:
    if shape.kind == "box":
        return box_mesh(shape.size)
    if shape.kind == "cylinder":
        return cylinder_mesh(float(shape.size[0]), float(shape.size[1]))
    if shape.kind == "sphere":
        return sphere_mesh(float(shape.size[0]))
    return file_mesh(found_file(shape.file, folder, packages), shape.size)


def found_file(name: str, folder: Path, packages: Mapping[str, Path]) -> Path:
    """The file that a description names: in its package, in its folder, or in a package that is given.

    A package is looked for among those given, else in the folders above the description.

    Raises:
        ScenarioError: there is none, or it lies elsewhere, also by a symbolic link.
    """
    name = unquote(name)
    if name.startswith(_PACKAGE):
        package, _, rest = name.removeprefix(_PACKAGE).partition("/")
        # Whatever lies in the root of the file system is no package.
        above = [one for one in (folder, *folder.parents) if one != one.parent]
        roots = [one / package for one in above] + [one for one in above if one.name == package]
        if package in packages:
            roots = [packages[package]]
        places: list[tuple[Path, tuple[Path, ...]]] = [(root / rest, (root,)) for root in roots]
        remedy = f"say where the package lies with --package {package}=FOLDER"
    else:
        own = next((one for one in (folder, *folder.parents) if (one / "package.xml").is_file()), folder)
        places = [(folder / name.removeprefix(_FILE), (own, *packages.values()))]
        remedy = "put the mesh where the description names it"
    for place, within in places:
        if _is_file(place):
            return _checked(place, within)
    raise ScenarioError(
        "a mesh is not found", expected=f"a file at {name[:200]}", got=f"none from {folder}", remedy=remedy
    )


def _is_file(place: Path) -> bool:
    try:
        return place.is_file()
    except (OSError, ValueError):
        # A name that no file can have.
        return False


def _checked(place: Path, within: Sequence[Path]) -> Path:
    real = place.resolve()
    if not any(real.is_relative_to(root.resolve()) for root in within):
        raise ScenarioError(
            "a mesh lies outside the robot's folder",
            expected=f"a file in {' or '.join(str(root) for root in within)}",
            got=str(real),
            remedy="copy it there, or name the folder that holds it with --package NAME=FOLDER",
        )
    return place
