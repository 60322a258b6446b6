"""XML files from others: small, and without a document type, whose entities could grow without end."""

from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.files import read_bounded

MAX_BYTES = 16_000_000


def read_xml(path: Path, root: str) -> Element:
    """The root element of a file.

    Raises:
        ScenarioError: there is no such file, it is too large, no XML, has a document type or another root.
    """
    data = read_bounded(
        path,
        MAX_BYTES,
        ScenarioError,
        remedy="give the path of a URDF or SRDF file; xacro makes one of a .xacro file",
    )
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    try:
        parser.Parse(data, True)  # noqa: FBT003 # takes no names
        found = builder.close()
    except (expat.ExpatError, ValueError) as error:
        raise _no_description(path, root, str(error)) from error
    if found.tag != root:
        raise _no_description(path, root, f"<{found.tag}>")
    return found


def attribute(element: Element, name: str, where: str) -> str:
    """An attribute that has to be there.

    Raises:
        ScenarioError: it is not.
    """
    value = element.get(name)
    if value is None:
        raise ScenarioError(
            f"{where} does not fit", expected=f"<{element.tag} {name}=...>", got=str(dict(element.attrib))
        )
    return value


def numbers(text: str, count: int, where: str) -> NDArray[np.float64]:
    """So many finite numbers, (count,).

    Raises:
        ScenarioError: the text holds others.
    """
    try:
        values = np.asarray([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ScenarioError(f"{where} does not fit", expected=f"{count} finite numbers", got=repr(text)[:200])
    return values


def _no_description(path: Path, root: str, got: str) -> ScenarioError:
    return ScenarioError(
        f"{path.name} is no such description",
        expected=f"XML of at most {MAX_BYTES // 1_000_000} MB with <{root}> as its root",
        got=got[:200],
    )


def _refuse(*_: object) -> None:
    raise ValueError("a document type")
