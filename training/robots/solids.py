"""The meshes of a piece of the robot, its primitives turned into such."""

from collections.abc import Mapping
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
    """The file that a description names.

    A package is looked for among those given, else in the folders above the description.

    Raises:
        ScenarioError: there is none.
    """
    name = unquote(name)
    if name.startswith(_PACKAGE):
        package, _, rest = name.removeprefix(_PACKAGE).partition("/")
        above = [folder, *folder.parents]
        places = [one / package / rest for one in above]
        places += [one / rest for one in above if one.name == package]
        if package in packages:
            places = [packages[package] / rest]
        remedy = f"say where the package lies with --package {package}=FOLDER"
    else:
        places, remedy = [folder / name.removeprefix(_FILE)], "put the mesh where the description names it"
    for place in places:
        if place.is_file():
            return place
    raise ScenarioError(
        "a mesh is not found", expected=f"a file at {name}", got=f"none from {folder}", remedy=remedy
    )
