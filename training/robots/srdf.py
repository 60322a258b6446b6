"""The pairs of links that an SRDF file says need no check."""

from pathlib import Path

from training.robots.xml_files import attribute, read_xml

Pairs = frozenset[frozenset[str]]


def read_disabled_pairs(path: Path) -> Pairs:
    """The disabled pairs of an SRDF file.

    Raises:
        ScenarioError: there is no such file, or it is none.
    """
    where = "a disabled pair"
    return frozenset(
        frozenset((attribute(one, "link1", where), attribute(one, "link2", where)))
        for one in read_xml(path, "robot").iterfind("disable_collisions")
    )
