"""Descriptions of robots: URDF by yourdfpy, xacro by xacro, disabled pairs of SRDF, packages of files.

A xacro file holds Python expressions. They are evaluated only if all their parts are on a list
(:func:`check`), and files are read only from the packages of the description. The expansion runs in a process
that the kernel bounds (:mod:`cspace.bounded_worker`).
"""

import ast
import os
import re
import resource
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from lxml import etree
from pydantic import BaseModel, ValidationError
from yourdfpy import URDF

from cspace import bounded_worker
from cspace.errors import ScenarioError
from cspace.files import project_error, read_yaml_file

XACRO = bounded_worker.Limits(cpu_s=10, wall_s=30.0)
_UNUSED = ("inertial", "material", "dynamics", "calibration")
# Elements that are read, and those that say nothing of limits, pairs or shapes.
_KNOWN = {
    *_UNUSED, "axis", "chain", "child", "collision", "contact", "disable_collisions",
    "disable_default_collisions", "enable_collisions", "end_effector", "gazebo", "group", "group_state",
    "hardwareInterface", "joint", "joint_property", "limit", "link", "mimic", "origin", "parent",
    "passive_joint", "ros2_control", "safety_controller", "sensor", "transmission", "verbose",
    "virtual_joint", "visual",
}  # fmt: skip
_FILE = "file://"
_POINTER = b"version https://git-lfs.github.com/spec/"
# Numbers, strings, collections, arithmetic, comparisons, calls and members. No functions, no comprehensions.
_ALLOWED = (
    ast.Expression, ast.Constant, ast.Name, ast.Load, ast.List, ast.Tuple, ast.Dict, ast.Set, ast.BinOp,
    ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Subscript, ast.Slice, ast.Call, ast.keyword,
    ast.Attribute, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
_UNDECLARED = etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE
# Members that reach others by their text, or types.
_FORBIDDEN = {"format", "format_map", "mro"}
# Larger ones, as in 9**9**9, take all the time that there is.
_EXPONENT = re.compile(r"-?\d\d?(\.\d+)?")


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """yourdfpy's links, parents first, its joints by the links after them, and warnings."""

    name: str
    links: dict[str, Any]
    joints: dict[str, Any]
    notes: tuple[str, ...]

    def behind(self, links: Collection[str]) -> list[str]:
        """Some links and all that hang on them, parents first."""
        found: list[str] = []
        for name in self.links:
            if name in links or (name in self.joints and self.joints[name].parent in found):
                found.append(name)
        return found


def read_description(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> Description:
    """The description in a URDF file, or in a ``.xacro`` file, which is expanded with the arguments."""
    robot = _read_xml(
        _expanded(path, packages, arguments) if path.suffix == ".xacro" else read_file(path), path
    )
    if any("xacro" in (etree.QName(element).namespace or "") for element in robot.iter("{*}*")):
        raise ScenarioError(
            f"{path.name} holds xacro, expand it first",
            expected="URDF",
            remedy="give the file a name that ends with .xacro, and the import expands it",
        )
    notes = _unused(robot.xpath("*|link/*|joint/*"), path)
    etree.strip_elements(robot, *_UNUSED, with_tail=False)
    try:
        data = BytesIO(etree.tostring(robot))
        read = URDF.load(data, build_scene_graph=False, load_meshes=False).robot
    except MemoryError:
        raise
    except Exception as error:  # yourdfpy raises whatever its parts do
        expected = "links with shapes that are box, cylinder, sphere or mesh, joints with parent and child"
        raise ScenarioError(
            f"{path.name} cannot be read", expected=expected, got=repr(error)[:200], remedy="try check_urdf"
        ) from error
    shapes = [shape for link in read.links for shape in (*link.collisions, *link.visuals)]
    if not np.isfinite([one.origin for one in (*shapes, *read.joints) if one.origin is not None]).all():
        raise ScenarioError(f"an <origin> in {path.name} does not fit", expected="finite numbers")
    links = {link.name: link for link in read.links}
    joints = {joint.child: joint for joint in read.joints}
    names = {joint.name for joint in read.joints}
    roots = [name for name in links if name not in joints]
    order = roots[:1]
    for link in order:
        order.extend(child for child, joint in joints.items() if joint.parent == link)
    if (
        set(order) != set(links)
        or not len(order) == len(read.links) == len(names) + 1 == len(read.joints) + 1
    ):
        raise ScenarioError(
            f"{path.name} is no tree of links",
            expected="a name for each link and joint, and one joint before each link but one root",
            got=f"{len(read.links)} links, {len(read.joints)} joints, roots {roots}"[:300],
        )
    return Description(read.name, {name: links[name] for name in order}, joints, notes)


def _unused(elements: Sequence[Any], path: Path) -> tuple[str, ...]:
    """A warning of elements that the import does not know."""
    names = {etree.QName(one).localname for one in elements} - _KNOWN
    return (f"{path.name}: not used, {', '.join(sorted(names))}",) if names else ()


def find_srdf(urdf: Path) -> Path | None:
    """The SRDF file of a description's name, in its folder or in ``../srdf``; None for none."""
    name, folder = f"{urdf.name.partition('.')[0]}.srdf", urdf.resolve().parent
    places = (folder / name, folder.parent / "srdf" / name)
    return next((one for one in places if one.is_file() and one.resolve() == one), None)


def read_srdf(path: Path, links: Collection[str]) -> tuple[dict[frozenset[str], str], list[str]]:
    """The pairs of links that an SRDF file says need no check, with its reasons, and warnings.

    As in MoveIt, ``enable_collisions`` takes pairs back from ``disable_default_collisions`` alone.
    """
    robot = _read_xml(read_file(path), path)
    pairs = {
        frozenset((one.get("link", ""), other)): one.tag
        for one in robot.iterfind("disable_default_collisions")
        for other in links
    }
    for one in robot.iterfind("enable_collisions"):
        pairs.pop(_pair(one), None)
    pairs |= {_pair(one): one.get("reason", "no reason") for one in robot.iterfind("disable_collisions")}
    unknown = sorted(set().union(*pairs) - set(links))
    notes = [f"{path.name} names links that are not there: {', '.join(unknown)}"] if unknown else []
    return pairs, [*_unused(robot, path), *notes]


def _pair(element: Any) -> frozenset[str]:
    return frozenset((element.get("link1", ""), element.get("link2", "")))


class JointLimit(BaseModel):
    """A joint's limits as MoveIt writes them."""

    has_position_limits: bool = False
    min_position: float = -np.inf
    max_position: float = np.inf
    has_velocity_limits: bool = False
    max_velocity: float = 0.0
    has_acceleration_limits: bool = False
    max_acceleration: float = 0.0


class _JointLimits(BaseModel):
    joint_limits: dict[str, JointLimit] = {}


def read_joint_limits(beside: Path, joints: Collection[str]) -> dict[str, JointLimit]:
    """The limits of joints in MoveIt's ``joint_limits.yaml`` beside a file; none if there is none."""
    path = beside.with_name("joint_limits.yaml")
    if not path.is_file():
        return {}
    try:
        rows = _JointLimits.model_validate(read_yaml_file(path, ScenarioError)).joint_limits
    except ValidationError as error:
        remedy = "move the file away, and give --limit JOINT=LOW,HIGH"
        raise project_error(error, ScenarioError, str(path), remedy) from error
    return {name: row for name, row in rows.items() if name in joints}


def read_file(path: Path) -> bytes:
    """The bytes of a file that is no pointer of Git LFS."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScenarioError(
            f"{path} cannot be read",
            expected="a file",
            got=error.strerror,
            remedy="give the path of a URDF, xacro or SRDF file",
        ) from error
    if data.startswith(_POINTER):
        raise ScenarioError(
            f"{path} is a pointer of Git LFS", expected="the file itself", remedy="run git lfs pull there"
        )
    return data


def _read_xml(data: bytes, path: Path) -> Any:
    """The root element <robot>. No entity is resolved, so no other file is read.

    Attributes with a prefix that is not declared, as some simulators' in URDF, are left out.
    """
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True, recover=True
    )
    try:
        found = etree.fromstring(data, parser)
        wrong = [one.message for one in parser.error_log if one.type != _UNDECLARED]
        if not wrong:
            wrong += [one.tag for one in found.iter("*") if ":" in one.tag.rpartition("}")[2]]
            wrong += ["a document type"] if found.getroottree().docinfo.doctype else []
        got = wrong[0][:200] if wrong else f"<{etree.QName(found).localname}>"
    except (etree.XMLSyntaxError, ValueError) as error:
        got = str(error)[:200]
    if got != "<robot>":
        raise ScenarioError(f"{path.name} is no description", expected="XML with the root <robot>", got=got)
    for element in found.iter("*"):
        for name in [one for one in element.attrib if ":" in one.rpartition("}")[2]]:
            del element.attrib[name]
    return found


def _expanded(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> bytes:
    folders = {name: str(folder.resolve()) for name, folder in packages.items()}
    text: str = bounded_worker.call(
        expand,
        str(path.resolve()),
        folders,
        dict(arguments),
        limits=XACRO,
        what=path.name,
        error=ScenarioError,
        remedy="import what xacro makes of a larger file elsewhere",
    )
    return text.encode()


def package_of(folder: Path) -> Path:
    """The nearest folder above that is a package; else the folder itself."""
    return next((one for one in (folder, *folder.parents) if _names_of_package(one)), folder)


def _names_of_package(folder: Path) -> set[str]:
    """Its own name and that of its ``package.xml``; none where it is no package of ROS or Gazebo."""
    if _is_file(folder / "package.xml"):
        text = (folder / "package.xml").read_text(encoding="utf-8", errors="replace")
        return {folder.name, *re.findall(r"<name>\s*([\w.-]+)\s*</name>", text)[:1]}
    return {folder.name} if _is_file(folder / "model.config") else set()


def _package_roots(name: str, folder: Path, packages: Mapping[str, Path]) -> list[Path]:
    """Where a package may lie: as given, else above the description or beside its own package."""
    if name in packages:
        return [packages[name]]
    if not re.fullmatch(r"\w[\w.-]{,99}", name):
        return []
    above, own = (folder, *folder.parents), package_of(folder)
    beside = sorted(one for one in own.parent.iterdir() if one.is_dir()) if _names_of_package(own) else []
    places = (*above, *(one / name for one in above), *beside)
    found = [root for root in places if name in _names_of_package(root)]
    # The description's own in a copy that left out what says so.
    return found + [one for one in (folder, folder.parent) if one.name == name and len(one.parts) > 2]


def found_file(name: str | None, folder: Path, packages: Mapping[str, Path]) -> Path:
    """The file that a description names: in its package, in its folder, or in a package that is given.

    A package is looked for among those given, else in the folders above the description. A file that lies
    elsewhere, also by a symbolic link, is not found.
    """
    name = unquote(name or "")
    if address := re.match("(?:package|model)://([^/]*)/*", name):
        remedy = f"say where the package lies with --package {address[1]}=FOLDER"
        roots = _package_roots(address[1], folder, packages)
        places = [(root / name[address.end() :], root) for root in roots]
    else:
        remedy = "put it where the description names it, or name its folder with --package NAME=FOLDER"
        place = folder / name.removeprefix(_FILE)
        places = [(place, root) for root in (package_of(folder), *packages.values())]
    for place, root in places:
        if _is_file(place) and place.resolve().is_relative_to(root.resolve()):
            return place
    raise ScenarioError(
        "a mesh is not found in the robot's folders",
        expected=f"a file at {name[:200]}",
        got=f"none from {folder}",
        remedy=remedy,
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        # A name that no file system takes.
        return False


def check(expression: str) -> None:
    """Raise ValueError for an expression of xacro that could do more than compute, or compute for long."""
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name = node.attr if isinstance(node, ast.Attribute) else ""
        name = name or (node.id if isinstance(node, ast.Name) and node.id.startswith("__") else "")
        exponent = node.right if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) else None
        if exponent is not None and not _EXPONENT.fullmatch(ast.unparse(exponent)):
            raise ValueError(f"an exponent is no number below 100: {expression[:100]}")
        if not isinstance(node, _ALLOWED) or name.startswith("_") or name in _FORBIDDEN:
            part = name or type(node).__name__
            raise ValueError(f"{part} is not allowed in an expression: {expression[:100]}")


def expand(file: str, packages: Mapping[str, str], arguments: Mapping[str, str]) -> str:
    """The text of a xacro file with its macros expanded; to be called in a bounded process."""
    import xacro  # noqa: PLC0415 - in the worker alone

    os.environ.clear()
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
    _restrict(xacro, Path(file).resolve().parent, {name: Path(one) for name, one in packages.items()})
    try:
        return str(xacro.process_file(file, mappings=dict(arguments)).toxml())
    except MemoryError:
        raise
    except Exception as problem:  # whatever a stranger's file makes xacro raise
        raise ScenarioError(
            f"xacro cannot expand {Path(file).name}",
            expected="macros and expressions as xacro documents them, and files of its packages alone",
            got=" ".join(f"{type(problem).__name__}: {problem}".split())[:400],
            remedy="give arguments by --xacro NAME=VALUE and folders of packages by --package NAME=FOLDER",
        ) from problem


def _restrict(xacro: Any, folder: Path, packages: Mapping[str, Path]) -> None:
    """Have xacro check expressions, find packages as they are given, and open files of these alone."""
    from xacro import substitution_args  # noqa: PLC0415

    allowed = [package_of(folder).resolve(), *(one.resolve() for one in packages.values())]

    def find(name: str) -> str:
        for root in _package_roots(name, folder, packages):
            allowed.append(root.resolve())
            return str(root)
        raise ValueError(f"package {name} is not found")

    def open_own(path: str) -> Any:
        real = Path(path).resolve()
        if not real.is_file() or not any(real.is_relative_to(root) for root in allowed):
            raise FileNotFoundError(2, "no file of the description's packages", str(path))
        return real.open(encoding="utf-8")

    def checked(evaluate: Callable[..., Any]) -> Callable[..., Any]:
        def evaluated(expression: str, *others: Any) -> Any:
            check(expression)
            return evaluate(expression, *others)

        return evaluated

    xacro.open, xacro.safe_eval = open_own, checked(xacro.safe_eval)
    for name in ("type", "vars"):
        del xacro._global_symbols["python"][name]  # noqa: SLF001
    substitution_args._eval = checked(substitution_args._eval)  # noqa: SLF001
    # As xacro's documentation of use without ROS does.
    substitution_args._eval_find = find  # noqa: SLF001
    substitution_args._eval_dict["find"] = find  # noqa: SLF001
