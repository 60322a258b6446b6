"""The serial chain in a description: fixed and locked joints folded, what hangs on it carried along."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import Joint
from cspace.worlds.spatial.poses import MAX_OFFSET_M, Frame, turn
from training.robots.urdf import Description, Matrix, Shape, UrdfJoint

_TURNING = {"revolute", "continuous"}


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A link of the description: its name, the link of the arm that it is fixed to, shapes in that frame."""

    name: str
    link: int
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """A serial arm without its spheres.

    Args:
        joints: of the arm.
        pieces: links that have shapes, from the base to the tip.
        tool: the tip's frame, in that of the last link.
        neighbours: pairs of links that a joint connects, fixed ones too.
    """

    joints: tuple[Joint, ...]
    pieces: tuple[Piece, ...]
    tool: Frame
    neighbours: frozenset[frozenset[str]]


def read_chain(
    description: Description,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> Chain:
    """The chain from a description's root to a tip.

    Args:
        description: of the robot.
        tip: the link whose frame is the tool's; None where only one link is last.
        locked: values of joints that do not move, rad or m.
        limits: of joints, instead of the description's, rad.

    Raises:
        ScenarioError: the tip is unknown or not clear, a joint that moves is off the chain, is not revolute
            or has no limits, or names of joints are unknown.
    """
    locked, limits = dict(locked or {}), dict(limits or {})
    known = {joint.name for joint in description.joints.values()}
    if unknown := sorted((set(locked) | set(limits)) - known):
        raise ScenarioError("joints are unknown", expected=f"some of {sorted(known)}", got=str(unknown))
    path = _path(description, _tip(description, tip))
    frames: dict[str, tuple[int, Matrix]] = {path[0]: (0, np.eye(4))}
    joints: list[Joint] = []
    order = _in_order(description, path)
    if apart := sorted(set(description.links) - {path[0], *order}):
        raise ScenarioError("the description is no tree of links", expected="one root", got=f"apart: {apart}")
    for link in order:
        joint = description.joints[link]
        number, before = frames[joint.parent]
        origin = before @ joint.origin
        if joint.kind == "fixed" or joint.name in locked:
            frames[link] = (number, origin @ _held(joint, locked.get(joint.name, 0.0)))
            continue
        if link not in path:
            raise _off_the_chain(joint)
        joints.append(_moving(joint, origin, limits.get(joint.name, joint.limits)))
        frames[link] = (len(joints), np.eye(4))
    pieces = tuple(
        Piece(name, number, tuple(replace(one, frame=frame @ one.frame) for one in description.links[name]))
        for name, (number, frame) in frames.items()
        if description.links[name]
    )
    pairs = frozenset(frozenset((joint.parent, joint.child)) for joint in description.joints.values())
    return Chain(tuple(joints), pieces, Frame.of(frames[path[-1]][1]), pairs)


def _tip(description: Description, tip: str | None) -> str:
    parents = {joint.parent for joint in description.joints.values()}
    last = sorted(set(description.links) - parents)
    if tip is None and len(last) == 1:
        return last[0]
    if tip is None or tip not in description.links:
        raise ScenarioError(
            "the tip of the chain is not clear",
            expected="one link of the description",
            got=f"several last ones: {last}" if tip is None else repr(tip)[:200],
            remedy="name a link with --tip",
        )
    return tip


def _path(description: Description, tip: str) -> list[str]:
    path = [tip]
    while path[-1] in description.joints:
        path.append(description.joints[path[-1]].parent)
        if len(path) > len(description.links):
            raise ScenarioError("the description is no tree of links", expected="a root", got="a ring")
    return path[::-1]


def _in_order(description: Description, path: list[str]) -> list[str]:
    """All links after the root, parents first, those of the path before others."""
    children: dict[str, list[str]] = {}
    for child, joint in description.joints.items():
        children.setdefault(joint.parent, []).append(child)
    order = list(path)
    for link in order:
        order.extend(child for child in children.get(link, ()) if child not in path)
    return order[1:]


def _held(joint: UrdfJoint, value: float) -> Matrix:
    result = np.eye(4)
    if not abs(value) <= MAX_OFFSET_M:
        raise ScenarioError(
            f"joint {joint.name} cannot be held there",
            expected=f"a value within {MAX_OFFSET_M:g} rad or m",
            got=f"{value:g}",
        )
    if joint.kind in _TURNING:
        result[:3, :3] = turn(joint.axis, value)
    elif joint.kind == "prismatic":
        result[:3, 3] = joint.axis * value
    elif joint.kind != "fixed":
        raise ScenarioError(
            f"joint {joint.name} cannot be held", expected="revolute, continuous, prismatic", got=joint.kind
        )
    return result


def _moving(joint: UrdfJoint, origin: Matrix, limits: tuple[float, float] | None) -> Joint:
    if joint.kind not in _TURNING:
        raise ScenarioError(
            f"joint {joint.name} does not fit a serial arm",
            expected="revolute or continuous joints",
            got=joint.kind,
            remedy=f"hold it with --lock {joint.name}=VALUE",
        )
    if joint.kind == "revolute" and limits is None:
        raise ScenarioError(
            f"joint {joint.name} has no limits",
            expected="<limit lower=... upper=...>",
            got="none",
            remedy=f"give --limit {joint.name}=LOW,HIGH, or make it continuous in the description",
        )
    x, y, z = joint.axis.tolist()
    return Joint(joint.name, Frame.of(origin), (x, y, z), limits)


def _off_the_chain(joint: UrdfJoint) -> ScenarioError:
    return ScenarioError(
        "the robot branches",
        expected="joints that move between the root and the tip only",
        got=f"joint {joint.name}, {joint.kind}, before link {joint.child}",
        remedy=f"hold it with --lock {joint.name}=VALUE, or name another link with --tip",
    )
