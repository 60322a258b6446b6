"""Descriptions of robots: safe XML, xacro expanded, URDF read by yourdfpy with each element's line, SRDF."""

import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from lxml import etree
from yourdfpy import URDF

from cspace import bounded
from cspace.errors import ScenarioError
from cspace.files import read_bounded
from training.robots.packages import expand

MAX_BYTES = 16_000_000
MAX_LINKS = 1000
XACRO = bounded.Limits(cpu_s=10, wall_s=30.0)
_REMEDY = "give the path of a URDF, xacro or SRDF file"
_NUMBER = re.compile(r"[-+]?((\d+\.?\d*|\.\d+)(e[-+]?\d+)?|inf(inity)?|nan)", re.ASCII | re.IGNORECASE)
# How many numbers attributes hold; a mesh's scale may be one for all axes.
_NUMBERS = dict.fromkeys(("xyz", "rpy", "size"), (3,)) | {"scale": (1, 3)}
_NUMBERS |= dict.fromkeys(("radius", "length", "multiplier", "offset", "lower", "upper"), (1,))
_LARGEST = 1e9
_UNUSED = ("inertial", "material", "dynamics", "calibration", "safety_controller")


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """yourdfpy's links (parents first), its joints by the links after them, lines by ``"link NAME"``."""

    name: str
    links: dict[str, Any]
    joints: dict[str, Any]
    lines: dict[str, int]

    def at(self, kind: str, name: str) -> str:
        """A link or a joint with its line, for messages."""
        return f"{kind} {name} (line {self.lines[f'{kind} {name}']})"


def read_description(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> Description:
    """The description in a URDF file, or in a file whose name ends with ``.xacro``, expanded with arguments.

    Raises:
        ScenarioError: there is no such file, xacro cannot expand it, or it is no tree of links.
    """
    data = read_bounded(path, MAX_BYTES, ScenarioError, remedy=_REMEDY)
    if path.suffix == ".xacro":
        data = _expanded(path, packages, arguments)
    robot = read_xml(data, path.name)
    for element in robot.iter("{*}*"):
        if "xacro" in (etree.QName(element).namespace or ""):
            raise ScenarioError(
                f"{path.name} holds xacro, expand it first",
                expected="URDF",
                got=f"<xacro:{etree.QName(element).localname}> in line {element.sourceline}",
                remedy="give the file a name that ends with .xacro, and the import expands it",
            )
    lines: dict[str, int] = {}
    links, joints = (_elements(robot, kind, lines) for kind in ("link", "joint"))
    by_child = {joint.child: joint for joint in joints.values()}
    unknown = sorted({str(name) for one in joints.values() for name in (one.parent, one.child)} - set(links))
    roots = [name for name in links if name not in by_child]
    order = roots[:1]
    for link in order:
        order.extend(child for child, joint in by_child.items() if joint.parent == link)
    if unknown or len(by_child) != len(joints) or len(roots) != 1 or len(order) != len(links):
        what = f"a link with two parents, a ring, or other than one root: {roots}"
        raise ScenarioError(
            "the description is no tree of links",
            expected="links that exist, one joint before each but one root",
            got=f"unknown links {unknown}" if unknown else what[:300],
        )
    return Description(robot.get("name", path.stem), {one: links[one] for one in order}, by_child, lines)


def find_srdf(urdf: Path) -> Path | None:
    """The SRDF file of a description's name, in its folder or in ``../srdf``; None for none."""
    name, folder = f"{urdf.name.partition('.')[0]}.srdf", urdf.resolve().parent
    places = (folder / name, folder.parent / "srdf" / name)
    return next((one for one in places if one.is_file() and one.resolve() == one), None)


def read_disabled_pairs(path: Path) -> dict[frozenset[str], str]:
    """The pairs of links that an SRDF file says need no check, with its reasons.

    Raises:
        ScenarioError: there is no such file, or it is none.
    """
    robot = read_xml(read_bounded(path, MAX_BYTES, ScenarioError, remedy=_REMEDY), path.name)
    found = {}
    for one in robot.iterfind("disable_collisions"):
        names = [one.get(key) for key in ("link1", "link2")]
        if not all(names):
            what = f"{path.name}, line {one.sourceline}: a disabled pair does not fit"
            raise ScenarioError(what, expected="link1 and link2", got=str(dict(one.attrib))[:200])
        found[frozenset(map(str, names))] = str(one.get("reason", "no reason"))
    return found


def read_xml(data: bytes, name: str, root: str = "robot") -> Any:
    """The root element of XML without a document type, whose entities could grow without end.

    Raises:
        ScenarioError: it is no XML, has a document type or another root.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True)
    try:
        found = etree.fromstring(data, parser)
        doctype = found.getroottree().docinfo.doctype
        got = "a document type" if doctype else f"<{etree.QName(found).localname}>"
    except (etree.XMLSyntaxError, ValueError) as error:
        got = str(error)[:200]
    if got != f"<{root}>":
        raise ScenarioError(f"{name} is no such description", expected=f"XML with the root <{root}>", got=got)
    return found


def _expanded(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> bytes:
    folders = {name: str(folder.resolve()) for name, folder in packages.items()}
    text: str = bounded.call(
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


def _elements(robot: Any, kind: str, lines: dict[str, int]) -> dict[str, Any]:
    """What yourdfpy reads of each link or joint, alone, so that an error has its name and its line."""
    found: dict[str, Any] = {}
    # Before they are read, which takes a while.
    if (count := len(robot.findall(kind))) > MAX_LINKS:
        most = f"at most {MAX_LINKS}"
        raise ScenarioError(f"the description has too many {kind}s", expected=most, got=str(count))
    for element in robot.iterfind(kind):
        name = element.get("name")
        where = f"{kind} {name} (line {element.sourceline})"
        if not name or name in found:
            raise ScenarioError(f"{where} does not fit", expected="a name of its own", got=repr(name))
        etree.strip_elements(element, *_UNUSED, with_tail=False)
        for part in element.iter():
            # An axis has to say its direction; readers differ in what they take instead.
            given = {"xyz": ""} if part.tag == "axis" else {}
            for key, text in (given | dict(part.attrib)).items():
                counts = _NUMBERS.get(key)
                # What limits that are not finite mean depends on the joint.
                finite = key not in {"lower", "upper"}
                if counts is not None and not _are_numbers(text, counts, finite=finite):
                    what = f"{key} of <{part.tag}> in line {part.sourceline}, of {where}, does not fit"
                    expected = f"{counts[-1]} finite numbers, up to 1e9" if finite else "a number"
                    raise ScenarioError(what, expected=expected, got=repr(text)[:200])
        alone = etree.Element("robot", name="one")
        alone.append(deepcopy(element))
        try:
            read = URDF.load(BytesIO(etree.tostring(alone)), build_scene_graph=False, load_meshes=False)
        except MemoryError:
            raise
        except Exception as error:  # yourdfpy raises whatever its parts do
            raise ScenarioError(
                f"{where} cannot be read",
                expected="a <parent> and a <child>, or shapes that are box, cylinder, sphere or mesh",
                got=repr(error)[:200],
            ) from error
        found[name] = (read.robot.links or read.robot.joints)[0]
        lines[f"{kind} {name}"] = element.sourceline
    return found


def _are_numbers(text: str, counts: tuple[int, ...], *, finite: bool) -> bool:
    words = text.replace(",", " ").split()
    # Python's own numbers may have underscores and digits of other scripts.
    fits = len(words) in counts and all(_NUMBER.fullmatch(one) for one in words)
    # Readers lose larger ones by their squares: an axis becomes none.
    return fits and (not finite or all(abs(float(one)) <= _LARGEST for one in words))
