"""A URDF file as values: links with the shapes that collide, and the joints between them."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.poses import Frame
from training.robots.xml_files import attribute, numbers, read_xml

Matrix = NDArray[np.float64]
MAX_LINKS = 1000
# Of what collides: no arm has smaller or larger parts.
MIN_SIZE_M, MAX_SIZE_M = 1e-4, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """What a link collides with.

    Args:
        kind: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
        frame: (4, 4), in the link's.
        size: sides; radius and length; radius; or scales, m.
        file: a mesh's, as the description names it.
    """

    kind: str
    frame: Matrix
    size: NDArray[np.float64]
    file: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint.

    Args:
        name: its own.
        kind: its type, as the description names it.
        parent: the link before it.
        child: the link after it.
        origin: (4, 4), its frame in the parent's.
        axis: (3,) unit vector.
        limits: low and high, rad or m; None where there are none.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Matrix
    axis: NDArray[np.float64]
    limits: tuple[float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A robot's description: its name, its links' shapes, its joints by the names of their children."""

    name: str
    links: dict[str, tuple[Shape, ...]]
    joints: dict[str, UrdfJoint]


def read_urdf(path: Path) -> Description:
    """The description in a file.

    Raises:
        ScenarioError: there is no such file, or it is no description of a tree of links.
    """
    robot = read_xml(path, "robot")
    links = {
        attribute(link, "name", "a link"): tuple(
            _shape(one, link.get("name", "")) for one in link.iterfind("collision")
        )
        for link in robot.iterfind("link")
    }
    if len(links) > MAX_LINKS:
        raise ScenarioError(
            "the description has too many links", expected=f"at most {MAX_LINKS}", got=str(len(links))
        )
    joints = [_joint(element) for element in robot.iterfind("joint")]
    by_child = {joint.child: joint for joint in joints}
    unknown = sorted({name for joint in joints for name in (joint.parent, joint.child)} - set(links))
    if unknown or len(by_child) != len(joints) or len({joint.name for joint in joints}) != len(joints):
        raise ScenarioError(
            "the description is no tree of links",
            expected="links that exist, one joint before each, names that are given once",
            got=f"unknown links {unknown}" if unknown else "a link with two parents, or a joint's name twice",
        )
    return Description(robot.get("name", path.stem), links, by_child)


def _frame(element: Element, where: str) -> Matrix:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz, rpy = (numbers(origin.get(key, "0 0 0"), 3, f"the origin of {where}") for key in ("xyz", "rpy"))
    return Frame(tuple(xyz.tolist()), tuple(rpy.tolist())).matrix()


def _shape(collision: Element, link: str) -> Shape:
    where = f"a collision shape of link {link}"
    geometry = collision.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    frame = _frame(collision, where)
    if shape is not None and shape.tag == "mesh":
        scale = numbers(shape.get("scale", "1 1 1"), 3, f"the scale of a mesh of link {link}")
        return Shape("mesh", frame, scale, attribute(shape, "filename", where))
    sizes = {"box": (("size", 3),), "cylinder": (("radius", 1), ("length", 1)), "sphere": (("radius", 1),)}
    if shape is None or shape.tag not in sizes:
        raise ScenarioError(
            f"{where} is unknown",
            expected="box, cylinder, sphere or mesh",
            got="none" if shape is None else shape.tag,
        )
    parts = [numbers(attribute(shape, name, where), count, where) for name, count in sizes[shape.tag]]
    size = np.concatenate(parts)
    if not (size.min() >= MIN_SIZE_M and size.max() <= MAX_SIZE_M):
        raise ScenarioError(
            f"{where} does not fit",
            expected=f"a {shape.tag} with sizes from {MIN_SIZE_M:g} to {MAX_SIZE_M:g} m",
            got=str(dict(shape.attrib))[:200],
        )
    return Shape(shape.tag, frame, size)


def _joint(element: Element) -> UrdfJoint:
    name = attribute(element, "name", "a joint")
    where = f"joint {name}"
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise ScenarioError(f"{where} does not fit", expected=f"a <{tag}>", got="none")
        ends.append(attribute(end, "link", where))
    axis, limit = element.find("axis"), element.find("limit")
    direction = numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0"), 3, f"the axis of {where}")
    # Its largest part is 1 now, so that no square overflows.
    direction = direction / (np.abs(direction).max() or 1.0)
    length = float(np.linalg.norm(direction))
    kind = attribute(element, "type", where)
    if kind != "fixed" and not length > 0.0:
        raise ScenarioError(f"the axis of {where} does not fit", expected="a direction", got="0 0 0")
    limits = None
    if limit is not None and {"lower", "upper"} & set(limit.attrib):
        low, high = (
            float(numbers(limit.get(key, "0"), 1, f"the limit of {where}")[0]) for key in ("lower", "upper")
        )
        limits = (low, high)
    return UrdfJoint(
        name, kind, ends[0], ends[1], _frame(element, where), direction / (length or 1.0), limits
    )
