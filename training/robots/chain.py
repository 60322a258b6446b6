"""The serial chain in a description: joints that do not move are folded, what hangs on them is carried."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.space import MIN_RANGE_RAD
from cspace.worlds.spatial.arm import Joint
from cspace.worlds.spatial.poses import Frame, turn
from training.robots.description import Description

Matrix = NDArray[np.float64]
Limits = tuple[float, float] | None
_TURNING = ("revolute", "continuous")
# Joints turn twice at most, some wrists a little more; more than four times is a range in degrees.
MAX_RANGE_RAD = 8.0 * np.pi
_AGREE = 1e-6
_GRIPPER = re.compile("gripper|finger|jaw|claw|hand", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Held:
    """A joint that does not move: its name, its type, its value (rad or m), and why it is held there."""

    name: str
    kind: str
    value: float
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """A serial arm without its spheres.

    ``frames`` holds, for all links and parents first, the arm's link that each is fixed to and its frame
    (4, 4) in that one's; ``tool`` is the tip's; ``held`` do not move; ``notes`` are warnings.
    """

    joints: tuple[Joint, ...]
    frames: dict[str, tuple[int, Matrix]]
    tool: Frame
    held: tuple[Held, ...]
    notes: tuple[str, ...]


def read_chain(
    description: Description,
    tip: str | None,
    locked: Mapping[str, float],
    limits: Mapping[str, Limits],
    without: Collection[str] = (),
) -> Chain:
    """The chain from a description's root to a tip.

    Joints beside the chain are held: at the value that is given, where the joint that they mimic puts them,
    else as near to zero as their limits allow. Joints in ``locked`` do not move, rad or m; ``limits`` replace
    the description's, rad, None for a circle. Links in ``without`` have no shapes, so where they are matters
    on the chain alone.
    """
    proposed, note = (tip, None) if tip is not None else _propose_tip(description, locked)
    path = _path(description, proposed)
    by_name = {joint.name: joint for joint in description.joints.values()}
    if unknown := sorted((set(locked) | set(limits)) - set(by_name)):
        raise ScenarioError("joints are unknown", expected=f"some of {sorted(by_name)}", got=str(unknown))
    moving = {
        joint.name
        for link, joint in description.joints.items()
        if link in path and joint.type != "fixed" and joint.mimic is None and joint.name not in locked
    }
    frames: dict[str, tuple[int, Matrix]] = {path[0]: (0, np.eye(4))}
    joints: list[Joint] = []
    held: list[Held] = []
    for link in list(description.links)[1:]:
        joint = description.joints[link]
        number, frame = frames[joint.parent]
        if joint.origin is not None:
            frame = frame @ joint.origin
        if joint.name in moving:
            joints.append(_moving(joint, frame, limits))
            number, frame = len(joints), np.eye(4)
        elif joint.type != "fixed" and (link in path or link not in without):
            held.append(_held(joint, by_name, locked, moving))
            frame = frame @ _displacement(joint, held[-1].value)
        frames[link] = (number, frame)
    if not joints:
        raise ScenarioError(
            "the chain has no joint that moves",
            expected="revolute or continuous joints between the root and the tip",
            got=f"none between {path[0]} and {path[-1]}",
            remedy="name another link with --tip",
        )
    outside = [one for one in held if not _within(by_name[one.name], one.value)]
    notes = [] if note is None else [note]
    if soft := [one for one in sorted(moving - set(limits)) if _soft(by_name[one])]:
        notes.append(f"the soft limits of safety_controller are taken: {', '.join(soft)}")
    notes += [f"joint {one.name} is held at {one.value:g}, outside its limits" for one in outside]
    return Chain(tuple(joints), frames, Frame.of(frames[path[-1]][1]), tuple(held), tuple(notes))


def _propose_tip(description: Description, locked: Mapping[str, float]) -> tuple[str | None, str | None]:
    """The last link before a gripper or the first branch, and a note on it; None where it is unclear.

    A gripper, like a branch, has fewer joints that move than the arm before it.
    """
    children: dict[str, list[Any]] = {name: [] for name in description.links}
    for joint in description.joints.values():
        children[joint.parent].append(joint)

    def moves(joint: Any) -> bool:
        return joint.type != "fixed" and joint.mimic is None and joint.name not in locked

    # Joints that move, from each joint on, by the link after it.
    moving: dict[str, int] = {}
    for name in reversed(list(description.links)[1:]):
        moving[name] = moves(description.joints[name]) + sum(moving[one.child] for one in children[name])
    at = next(iter(description.links))
    total = sum(moving[one.child] for one in children[at])
    while children[at]:
        ahead = [one for one in children[at] if moving[one.child]]
        passed = total - sum(moving[one.child] for one in ahead)
        small = all(moving[one.child] < passed for one in ahead)
        # A link of a gripper that the wrist turns is still the arm's.
        named = ((one, one.name if moves(one) else f"{one.name} {one.child}") for one in ahead)
        gripper = next((one.child for one, names in named if _GRIPPER.search(names)), None)
        if len(ahead) > 1 and not small:
            return None, None
        if (gripper is not None and small) or len(ahead) > 1 or (not ahead and len(children[at]) > 1):
            why = "the first branch" if gripper is None else f"the gripper {gripper}"
            return at, f"the tip is {at}, the last link before {why}; --tip names another"
        at = (ahead or children[at])[0].child
    return at, None


def _path(description: Description, tip: str | None) -> list[str]:
    """The links from the root to the tip."""
    if tip not in description.links:
        last = sorted(set(description.links) - {joint.parent for joint in description.joints.values()})
        raise ScenarioError(
            "the tip of the chain is not clear",
            expected=f"one link of the description; the last ones are {', '.join(last)}"[:500],
            got="several" if tip is None else repr(tip)[:200],
            remedy="name a link with --tip",
        )
    path = [str(tip)]
    while path[-1] in description.joints:
        path.append(description.joints[path[-1]].parent)
    return path[::-1]


def _moving(joint: Any, origin: Matrix, limits: Mapping[str, Limits]) -> Joint:
    name = joint.name
    if joint.type not in _TURNING:
        raise ScenarioError(
            f"joint {name} does not fit a serial arm",
            expected="revolute or continuous joints; the model of the arm has no others",
            got=str(joint.type),
            remedy=f"hold it with --lock {name}={'VALUE' if joint.type == 'prismatic' else 0}",
        )
    x, y, z = _axis(joint).tolist()
    found = limits[name] if name in limits else _limits(joint)
    return Joint(name, Frame.of(origin), (x, y, z), found)


def _limits(joint: Any) -> Limits:
    if joint.type == "continuous":
        return None
    name, (low, high) = joint.name, _bounds(joint)
    if soft := _soft(joint):
        low, high = soft
    if MIN_RANGE_RAD <= high - low <= MAX_RANGE_RAD:
        return low, high
    got, proposed = f"{low:g} to {high:g}", "LOW,HIGH"
    if np.isinf(high - low):
        got = "none"
    elif high - low > MAX_RANGE_RAD:
        got += ", which look like degrees"
        proposed = f"{np.deg2rad(low):.4f},{np.deg2rad(high):.4f}"
    raise ScenarioError(
        f"the limits of joint {name} do not fit",
        expected=f"<limit lower=... upper=...> in rad, {MIN_RANGE_RAD} to {MAX_RANGE_RAD:.1f} apart",
        got=got,
        remedy=f"give --limit {name}={proposed} in rad, --limit {name}=none for a circle, "
        f"or --lock {name}=VALUE",
    )


def _bounds(joint: Any) -> tuple[float, float]:
    """A joint's limits, as far as there are some; a missing end beside one that is there is 0, as in URDF."""
    limit = joint.limit
    if limit is None or (limit.lower is None and limit.upper is None):
        return -np.inf, np.inf
    return limit.lower or 0.0, limit.upper or 0.0


def _soft(joint: Any) -> Limits:
    """The soft limits of a joint where they leave some of its range, as MoveIt takes them, and narrow it."""
    safety, (low, high) = joint.safety_controller, _bounds(joint)
    if joint.type != "revolute" or safety is None:
        return None
    soft = max(low, safety.soft_lower_limit or 0.0), min(high, safety.soft_upper_limit or 0.0)
    return soft if soft[0] < soft[1] and soft != (low, high) else None


def _within(joint: Any, value: float) -> bool:
    low, high = _bounds(joint)
    return joint.type == "continuous" or low - _AGREE <= value <= high + _AGREE


def _held(joint: Any, by_name: Mapping[str, Any], locked: Mapping[str, float], moving: set[str]) -> Held:
    """Where a joint that does not move is held, and why."""
    name = joint.name
    if name in locked:
        return Held(name, joint.type, locked[name], "--lock")
    if joint.mimic is None:
        low, high = (-np.inf, np.inf) if joint.type == "continuous" else _bounds(joint)
        return Held(name, joint.type, float(np.clip(0.0, low, max(low, high))), "beside the chain")
    leader = by_name.get(joint.mimic.joint)
    if leader is None or leader.mimic is not None or leader.name in moving:
        moves = leader is not None and leader.name in moving
        what = "one that moves" if moves else "none, or one that follows another"
        raise ScenarioError(
            f"joint {name} cannot follow joint {joint.mimic.joint}",
            expected="a joint beside the chain that follows no other",
            got=what,
            remedy=f"hold one of them with --lock NAME=VALUE, name a link before {name} with --tip, "
            f"or leave out what lies beside the chain with --without {joint.child}",
        )
    value = joint.mimic.multiplier * _held(leader, by_name, locked, moving).value + joint.mimic.offset
    return Held(name, joint.type, float(value), f"follows {leader.name}")


def _displacement(joint: Any, value: float) -> Matrix:
    """(4, 4): the transform of a joint that is held at a value."""
    result = np.eye(4)
    if joint.type in _TURNING:
        result[:3, :3] = turn(_axis(joint), value)
    elif joint.type == "prismatic":
        result[:3, 3] = _axis(joint) * value
    elif value:
        raise ScenarioError(
            f"joint {joint.name} cannot be held there",
            expected=f"0, for it is {joint.type}",
            got=f"{value:g}",
        )
    return result


def _axis(joint: Any) -> NDArray[np.float64]:
    length = float(np.linalg.norm(joint.axis))
    if not (0.0 < length < np.inf and len(joint.axis) == 3):
        got = str(joint.axis.tolist())
        raise ScenarioError(f"the axis of joint {joint.name} does not fit", expected="a direction", got=got)
    return np.asarray(joint.axis / length)
