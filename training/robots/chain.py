"""The serial chain in a description: joints that do not move are folded, what hangs on them is carried."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.space import MIN_RANGE_RAD
from cspace.worlds.spatial.arm import Joint
from cspace.worlds.spatial.poses import MAX_OFFSET_M, Frame, turn
from training.robots.description import Description

Matrix = NDArray[np.float64]
Limits = tuple[float, float] | None
_TURNING = ("revolute", "continuous")
# Joints turn twice at most, some wrists a little more; more than four times is a range in degrees.
MAX_RANGE_RAD = 8.0 * np.pi
_AGREE = 1e-6
_GRIPPER = re.compile("gripper|finger|jaw|claw|hand", re.IGNORECASE)
# Of joints that follow each other.
_MOST_LEADERS = 100


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
    description: Description, tip: str | None, locked: Mapping[str, float], limits: Mapping[str, Limits]
) -> Chain:
    """The chain from a description's root to a tip.

    Joints beside the chain are held: at the value that is given, where the joint that they mimic puts them,
    else as near to zero as their limits allow.

    Joints in ``locked`` do not move, rad or m; ``limits`` replace the description's, rad, None for a circle.

    Raises:
        ScenarioError: the tip is not clear, a joint between root and tip can neither move nor be held, its
            limits are missing or no range, or names of joints are unknown.
    """
    proposed, note = (tip, None) if tip is not None else _propose_tip(description, locked)
    path = _path(description, proposed)
    reader = _Reader(description, path, locked, limits)
    reader.notes += [] if note is None else [note]
    if unknown := sorted((set(locked) | set(limits)) - set(reader.by_name)):
        known = f"some of {sorted(reader.by_name)}"
        raise ScenarioError("joints are unknown", expected=known, got=str(unknown))
    frames: dict[str, tuple[int, Matrix]] = {path[0]: (0, np.eye(4))}
    joints: list[Joint] = []
    for link in list(description.links)[1:]:
        joint = description.joints[link]
        number, before = frames[joint.parent]
        origin = before if joint.origin is None else before @ joint.origin
        if joint.type == "fixed" or joint.name in locked or link not in path or joint.mimic is not None:
            frames[link] = (number, origin @ reader.hold(joint))
        else:
            joints.append(reader.moving(joint, origin))
            frames[link] = (len(joints), np.eye(4))
    if not joints:
        raise ScenarioError(
            "the chain has no joint that moves",
            expected="revolute or continuous joints between the root and the tip",
            got=f"none between {path[0]} and {path[-1]}",
            remedy="name another link with --tip",
        )
    tool = Frame.of(frames[path[-1]][1])
    return Chain(tuple(joints), frames, tool, tuple(reader.held), tuple(reader.notes))


def _propose_tip(description: Description, locked: Mapping[str, float]) -> tuple[str | None, str | None]:
    """The last link before a gripper or the first branch, and a note on it; None where it is unclear.

    A gripper, like a branch, has fewer joints that move than the arm before it.
    """
    children: dict[str, list[Any]] = {name: [] for name in description.links}
    for joint in description.joints.values():
        children[joint.parent].append(joint)
    # Joints that move, from each joint on, by the link after it.
    moving: dict[str, int] = {}
    for name in reversed(list(description.links)[1:]):
        joint = description.joints[name]
        own = joint.type != "fixed" and joint.mimic is None and joint.name not in locked
        moving[name] = own + sum(moving[one.child] for one in children[name])
    at = next(iter(description.links))
    total = sum(moving[one.child] for one in children[at])
    while children[at]:
        ahead = [one for one in children[at] if moving[one.child]]
        passed = total - sum(moving[one.child] for one in ahead)
        small = all(moving[one.child] < passed for one in ahead)
        gripper = next((one.child for one in ahead if _GRIPPER.search(f"{one.name} {one.child}")), None)
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
            expected="one link of the description",
            got=f"several last ones: {last}" if tip is None else repr(tip)[:200],
            remedy="name a link with --tip",
        )
    path = [str(tip)]
    while path[-1] in description.joints:
        path.append(description.joints[path[-1]].parent)
    return path[::-1]


class _Reader:
    """Finds where joints are held, and the limits of those that move."""

    def __init__(
        self,
        description: Description,
        path: list[str],
        locked: Mapping[str, float],
        limits: Mapping[str, Limits],
    ) -> None:
        self.description, self.path, self.locked, self.limits = description, path, locked, limits
        self.by_name = {joint.name: joint for joint in description.joints.values()}
        self.held: list[Held] = []
        self.notes: list[str] = []

    def hold(self, joint: Any) -> Matrix:
        """(4, 4): the transform of a joint that does not move."""
        result = np.eye(4)
        if joint.type == "fixed":
            return result
        where = self.description.at("joint", joint.name)
        value, why = self._value(joint, ())
        most = MAX_OFFSET_M if joint.type in (*_TURNING, "prismatic") else 0.0
        if not abs(value) <= most:
            raise ScenarioError(
                f"{where} cannot be held there",
                expected=f"a value within {most:g} rad or m for a joint that is {joint.type}",
                got=f"{value:g}",
            )
        low, high = _bounds(joint)
        if joint.type != "continuous" and not low - _AGREE <= value <= high + _AGREE:
            self.notes.append(f"{where} is held at {value:g}, outside its limits")
        self.held.append(Held(joint.name, joint.type, value, why))
        if joint.type in _TURNING:
            result[:3, :3] = turn(self._axis(joint), value)
        elif joint.type == "prismatic":
            result[:3, 3] = self._axis(joint) * value
        return result

    def moving(self, joint: Any, origin: Matrix) -> Joint:
        """A joint of the arm."""
        name, where = joint.name, self.description.at("joint", joint.name)
        if joint.type not in _TURNING:
            raise ScenarioError(
                f"{where} does not fit a serial arm",
                expected="revolute or continuous joints; the model of the arm has no others",
                got=str(joint.type),
                remedy=f"hold it with --lock {name}={'VALUE' if joint.type == 'prismatic' else 0}",
            )
        limits = self.limits[name] if name in self.limits else self._limits(joint, where)
        width = 0.0 if limits is None else limits[1] - limits[0]
        if limits is not None and width > MAX_RANGE_RAD:
            low, high = np.deg2rad(limits)
            raise ScenarioError(
                f"the limits of {where} are no angles in rad",
                expected=f"a range of at most {MAX_RANGE_RAD:.1f} rad, four turns",
                got=f"{limits[0]:g} to {limits[1]:g}, which look like degrees",
                remedy=f"give --limit {name}={low:.4f},{high:.4f}, or correct the description",
            )
        if width > MAX_RANGE_RAD / 2.0 + 0.01:
            self.notes.append(f"{where} has a range of {width:.1f} rad, more than two turns")
        x, y, z = self._axis(joint).tolist()
        return Joint(name, Frame.of(origin), (x, y, z), limits)

    def _limits(self, joint: Any, where: str) -> Limits:
        low, high = _bounds(joint)
        if joint.type == "continuous":
            if low < high and np.isfinite(high - low):
                self.notes.append(
                    f"{where} is continuous: its limits {low:g} to {high:g} mean nothing in URDF"
                )
            return None
        if not (np.isfinite(high - low) and high - low >= MIN_RANGE_RAD):
            raise ScenarioError(
                f"the limits of {where} do not fit",
                expected=f"<limit lower=... upper=...> with low < high by {MIN_RANGE_RAD} rad or more",
                got="none" if np.isinf(high - low) else f"{low:g} to {high:g}",
                remedy=f"give --limit {joint.name}=LOW,HIGH in rad, --limit {joint.name}=none for a circle, "
                f"or --lock {joint.name}=VALUE",
            )
        return low, high

    def _axis(self, joint: Any) -> NDArray[np.float64]:
        # Its largest part is 1 now, so that no square overflows.
        axis = np.asarray(joint.axis) / (np.abs(joint.axis).max() or 1.0)
        length = float(np.linalg.norm(axis))
        if not length > 0.0:
            where = self.description.at("joint", joint.name)
            raise ScenarioError(f"the axis of {where} does not fit", expected="a direction", got="0 0 0")
        return np.asarray(axis / length)

    def _value(self, joint: Any, seen: tuple[str, ...]) -> tuple[float, str]:
        """Where a joint is held, and why."""
        where = self.description.at("joint", joint.name)
        if joint.mimic is None:
            low, high = _bounds(joint)
            near = 0.0 if joint.type == "continuous" else float(np.clip(0.0, low, max(low, high)))
            given = self.locked.get(joint.name)
            return (near, "beside the chain") if given is None else (given, "--lock")
        name = joint.mimic.joint
        leader = self.by_name.get(name)
        if leader is None or name in seen or len(seen) > _MOST_LEADERS:
            got = repr(name) if leader is None else f"a ring or a long row through {name}"
            raise ScenarioError(f"{where} mimics no joint", expected="a joint of the description", got=got)
        if leader.mimic is None and name not in self.locked and leader.child in self.path[1:]:
            raise ScenarioError(
                f"{where} follows joint {name}, which moves",
                expected="joints that move on their own",
                got=f"mimic with multiplier {joint.mimic.multiplier:g} and offset {joint.mimic.offset:g}",
                remedy=f"hold both with --lock {name}=VALUE, or name a link before them with --tip",
            )
        ahead = self._value(leader, (*seen, joint.name))[0]
        value = float(joint.mimic.multiplier * ahead + joint.mimic.offset)
        if not abs(self.locked.get(joint.name, value) - value) <= _AGREE:
            raise ScenarioError(
                f"{where} follows joint {name} and cannot be held elsewhere",
                expected=f"{value:g}",
                got=f"{self.locked[joint.name]:g}",
                remedy=f"hold joint {name} instead: --lock {name}=VALUE",
            )
        return value, f"follows {name}"


def _bounds(joint: Any) -> tuple[float, float]:
    """A joint's limits, as far as there are some; a missing end beside one that is there is 0, as in URDF."""
    limit = joint.limit
    if limit is None or (limit.lower is None and limit.upper is None):
        return -np.inf, np.inf
    return limit.lower or 0.0, limit.upper or 0.0
