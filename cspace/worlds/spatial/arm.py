"""The robot: a serial arm of revolute joints, whose parts are covered by spheres. NumPy alone."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.files import LEFT_OUT, Record, read_object, validated
from cspace.space import JointSpace, is_range
from cspace.worlds.spatial.poses import MAX_OFFSET_M, SAME, Frame, Offset, Vector, moved, turn

_UNIT = 1e-9
# The name of its frame.
TOOL = "tool"
# With more, parts could run through each other.
MAX_OVERLAP_M = 0.02
Sphere = tuple[Offset, Offset, Offset, Annotated[float, Field(gt=0.0, le=MAX_OFFSET_M)]]
Rates = tuple[Annotated[float, Field(gt=0.0)], ...]
_Name = Annotated[str, Field(min_length=1)]


@validated(ScenarioError)
class Joint:
    """A revolute joint."""

    name: _Name
    origin: Frame = SAME  # its frame, in that of the link before it, where its angle is zero
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limits_rad: tuple[float, float] | None = None  # (low, high); None where it is a circle

    def __post_init__(self) -> None:
        if not abs(float(np.linalg.norm(self.axis)) - 1.0) <= _UNIT:
            raise ScenarioError(
                f"the axis of joint {self.name} does not fit", expected="a unit vector", got=str(self.axis)
            )
        if (limits := self.limits_rad) is not None and not is_range(*limits):
            raise ScenarioError(
                f"the limits of joint {self.name} do not fit", expected="low < high, rad", got=str(limits)
            )


@validated(ScenarioError)
class Part:
    """A rigid piece of the arm."""

    name: _Name
    link: int  # what it is fixed to: 0 for the base, k for what joint k moves
    spheres_m: Annotated[tuple[Sphere, ...], Field(min_length=1)]
    # Spheres stick out of what they cover, so two parts touch where spheres overlap by more than the sum of
    # both values. If one part has None, they touch as soon as spheres do.
    overlap_m: Annotated[float | None, Field(ge=0.0, le=MAX_OVERLAP_M), LEFT_OUT] = None


KIND = "serial_arm"
MAX_JOINTS = 10
# How far above and aside of the base shoulders are, as a rule at most, m.
_HIGH_M, _ASIDE_M = 0.48, 0.2
MAX_SPHERES = 2000


@validated(ScenarioError)
class SerialArm(Record):
    """A serial arm with its base at the origin, x forward and z up."""

    name: str
    joints: Annotated[tuple[Joint, ...], Field(min_length=1, max_length=MAX_JOINTS)]
    parts: tuple[Part, ...] = ()
    touching: tuple[tuple[str, str], ...] = ()
    tool: Frame = SAME
    # (d,) where it waits, in scenes that are drawn; None for the middle of its limits
    ready_rad: Annotated[tuple[float, ...] | None, LEFT_OUT] = None
    # (d,) of trajectories, which make it no other robot
    max_velocity_rad_s: Annotated[Rates | None, LEFT_OUT] = field(default=None, compare=False)
    max_acceleration_rad_s2: Annotated[Rates | None, LEFT_OUT] = field(default=None, compare=False)

    def __post_init__(self) -> None:
        for what, named in (("joints", self.joints), ("parts", self.parts)):
            names = [one.name for one in named]
            if len(set(names)) != len(names):
                raise ScenarioError(f"the arm's {what} do not fit", expected="a name each", got=str(names))
        astray = [part.name for part in self.parts if not 0 <= part.link <= self.dim]
        if astray or self.sphere_count > MAX_SPHERES:
            raise ScenarioError(
                "the arm's parts do not fit",
                expected=f"at most {MAX_SPHERES} spheres",
                got=f"{self.sphere_count}; on no link: {astray}",
            )
        links = {part.name: part.link for part in self.parts}
        pairs = [tuple(sorted(pair)) for pair in self.touching]
        wrong = [pair for pair in pairs if not set(pair) <= set(links) or links[pair[0]] == links[pair[1]]]
        if wrong or len(set(pairs)) != len(pairs):
            raise ScenarioError("the pairs of parts that can touch do not fit", got=str(wrong or pairs)[:200])
        for rates in (self.max_velocity_rad_s, self.max_acceleration_rad_s2):
            if rates is not None and len(rates) != self.dim:
                expected = f"{self.dim} positive numbers"
                raise ScenarioError("limits of motion do not fit", expected=expected, got=str(rates)[:200])
        ready = self.ready_rad
        if ready is not None:
            what = "the arm cannot wait there"
            if len(ready) != self.dim:
                raise ScenarioError(what, expected=f"{self.dim} angles", got=str(ready))
            object.__setattr__(
                self, "ready_rad", tuple(self.space.admitted(ready, what, ScenarioError).tolist())
            )

    def __hash__(self) -> int:
        # Equal arms have equal ones, and hundreds of spheres are not gone through.
        return hash((self.name, self.joints, self.tool))

    @property
    def dim(self) -> int:
        """d, number of joints; links are counted from 0, the base, to d."""
        return len(self.joints)

    @property
    def space(self) -> JointSpace:
        limits = [joint.limits_rad for joint in self.joints]
        return JointSpace(
            tuple(-np.pi if lim is None else lim[0] for lim in limits),
            tuple(np.pi if lim is None else lim[1] for lim in limits),
            tuple(lim is None for lim in limits),
            tuple(joint.name for joint in self.joints),
        )

    def with_limits(self, limits_rad: Sequence[tuple[float, float] | None]) -> "SerialArm":
        """The same arm with other limits, one pair for each joint, None for a circle."""
        pairs = zip(self.joints, limits_rad, strict=True)
        return replace(self, joints=tuple(replace(joint, limits_rad=one) for joint, one in pairs))

    @property
    def sphere_count(self) -> int:
        return sum(len(part.spheres_m) for part in self.parts)

    @property
    def reach_m(self) -> float:
        """No less than the distance from the base to any point of the arm."""
        steps = np.cumsum([0.0, *(np.linalg.norm(joint.origin.xyz_m) for joint in self.joints)])
        tips = [steps[-1] + np.linalg.norm(self.tool.xyz_m)]
        for part in self.parts:
            spheres = np.asarray(part.spheres_m)
            tips.append(steps[part.link] + (np.linalg.norm(spheres[:, :3], axis=1) + spheres[:, 3]).max())
        return float(max(tips))

    @property
    def usual_base_m(self) -> Vector:
        """Where the base would be if it were below the shoulder as most are, m: (0, 0, 0) but for stands."""
        x, y, z = self.joints[0].origin.xyz_m
        if z <= _HIGH_M and x * x + y * y <= _ASIDE_M * _ASIDE_M:
            return (0.0, 0.0, 0.0)
        return (x, y, max(0.0, z - _HIGH_M))

    def link_frames(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (N, d) rad to the links' frames in the base's, (N, d + 1, 4, 4), m."""
        rows, (origins, axes) = np.asarray(configurations, dtype=np.float64), joint_arrays(self)
        own = np.zeros((len(rows), self.dim, 4, 4))
        own[..., :3, :3] = turn(axes, rows)
        own[..., 3, 3] = 1.0
        frames = np.empty((len(rows), self.dim + 1, 4, 4))
        frames[:, 0] = np.eye(4)
        for index, origin in enumerate(origins):
            frames[:, index + 1] = frames[:, index] @ origin @ own[:, index]
        return frames

    def tool_frames(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (N, d) rad to the tool's frame in the base's, (N, 4, 4), m."""
        return np.asarray(self.link_frames(configurations)[:, -1] @ self.tool.matrix())

    def frame_of(self, name: str, configuration: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (d,) rad to a frame that :meth:`named_frame` knows in the base's, (4, 4), m."""
        link, frame = self.named_frame(name)
        row = np.asarray(configuration, dtype=np.float64)
        return np.asarray(self.link_frames(row[None])[0, link] @ frame)

    def named_frame(self, name: str) -> tuple[int, NDArray[np.float64]]:
        """The link of a named frame (joint, link or tool), and the frame in that link's, (4, 4) m."""
        links = {joint.name: number for number, joint in enumerate(self.joints, 1)}
        fixed = {part.name: part.link for part in self.parts if part.link}
        first = {link: name for name, link in reversed(fixed.items())}
        links |= {name: link for link, name in sorted(first.items())}
        if name in links:
            return links[name], np.eye(4)
        if name == TOOL:
            return self.dim, self.tool.matrix()
        remedy = "give the pose of what stands still in the base, without a link"
        if name in fixed:
            moving = [one for one, link in links.items() if link == fixed[name]][-1]
            remedy = (
                f"the frame of {name} is not known: it is fixed to {moving}, so give the pose in that one's"
            )
        raise ScenarioError(
            f"the robot {self.name} has no such link",
            expected=f"one of {', '.join((*links, TOOL))}",
            got=repr(name)[:100],
            remedy=remedy,
        )

    def joint_positions_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (N, d) rad to (N, d + 2, 3) m: the base, every joint, the tool."""
        frames = self.link_frames(np.atleast_2d(np.asarray(configurations, dtype=np.float64)))
        tips = frames[:, -1] @ self.tool.matrix()
        return np.concatenate([frames[:, :, :3, 3], tips[:, None, :3, 3]], axis=1)

    def sphere_ranges(self) -> NDArray[np.int64]:
        """First sphere of each part and the one after its last, (P, 2)."""
        ends = np.cumsum([0, *(len(part.spheres_m) for part in self.parts)], dtype=np.int64)
        return np.stack([ends[:-1], ends[1:]], axis=1)

    def sphere_links(self) -> NDArray[np.int64]:
        """The link that each sphere is fixed to, (S,), in the order of the parts."""
        return np.repeat(
            np.asarray([part.link for part in self.parts], dtype=np.int64),
            [len(part.spheres_m) for part in self.parts],
        )

    def spheres_m(self) -> NDArray[np.float64]:
        """Centre in its link's frame and radius of every sphere, (S, 4), in the order of the parts."""
        return _spheres(self)

    def own_radii_m(self) -> NDArray[np.float64]:
        """(S,) radii by which the arm's parts are held apart from each other."""
        radii = [np.asarray(part.spheres_m)[:, 3] - (part.overlap_m or 0.0) for part in self.parts]
        return np.asarray(np.maximum(np.concatenate([np.empty(0), *radii]), 0.0))

    def sphere_centres_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (N, d) rad to the spheres' centres in the base's frame, (N, S, 3)."""
        return moved(self.link_frames(configurations)[:, self.sphere_links()], self.spheres_m()[:, :3])

    def spheres_at(self, configuration: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (d,) rad to centre in the base's frame and radius of every sphere, (S, 4) m."""
        row = np.asarray(configuration, dtype=np.float64)
        return np.concatenate([self.sphere_centres_m(row[None])[0], self.spheres_m()[:, 3:]], axis=1)

    def to_dict(self) -> dict[str, Any]:
        return {"kind": KIND, **Record.to_dict(self)}

    @classmethod
    def from_dict(cls, values: object) -> "SerialArm":
        members = {"kind": KIND} | read_object(dict[str, Any], values, "the robot", ScenarioError)
        if (kind := members.pop("kind")) != KIND:
            raise ScenarioError("the robot is unknown", expected=KIND, got=repr(kind)[:200])
        return read_object(cls, members, "the robot", ScenarioError)


@lru_cache(maxsize=16)
def joint_arrays(arm: SerialArm) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frames (d, 4, 4) of an arm's joints in those of the links before them, and their axes (d, 3)."""
    origins = np.stack([joint.origin.matrix() for joint in arm.joints])
    return origins, np.asarray([joint.axis for joint in arm.joints], dtype=np.float64)


@lru_cache(maxsize=16)
def _spheres(arm: SerialArm) -> NDArray[np.float64]:
    found = np.concatenate([np.empty((0, 4)), *(np.asarray(part.spheres_m) for part in arm.parts)])
    found.setflags(write=False)
    return found


def ready_rad(arm: SerialArm) -> NDArray[np.float64]:
    """(d,) rad: the pose that an arm waits in; where nobody said, the middle of its joints' limits."""
    if arm.ready_rad is not None:
        return np.asarray(arm.ready_rad, dtype=np.float64)
    space = arm.space
    return np.where(space.periodic, 0.0, (np.asarray(space.lower) + np.asarray(space.upper)) / 2.0)


def touching_sets(arm: SerialArm) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]:
    """Pairs of sets of spheres, numbers (a,) and (b,), all of whose pairs can touch; each pair is in one."""
    ranges = zip(arm.parts, arm.sphere_ranges().tolist(), strict=True)
    own = {part.name: np.arange(*span) for part, span in ranges}
    partners = {name: tuple(sorted(b for a, b in arm.touching if a == name)) for name in own}
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, others in partners.items():
        if others:
            alike.setdefault(others, []).append(name)
    return tuple(
        (np.concatenate([own[one] for one in names]), np.concatenate([own[one] for one in others]))
        for others, names in alike.items()
    )


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Groups of an arm's S spheres, G of them, in the order of the parts."""

    links: NDArray[np.int64]  # (G,) the link of each group
    spheres_m: NDArray[np.float64]  # (G, 4) in the link's frame, each of which holds a group
    groups: NDArray[np.int64]  # (S,) the group of each of the arm's spheres

    @property
    def members(self) -> NDArray[np.int64]:
        """(G, most) numbers of the spheres in each group, the first of them repeated behind the last."""
        held = [np.flatnonzero(self.groups == number) for number in range(len(self.links))]
        most = max(len(one) for one in held)
        return np.stack([np.append(one, np.full(most - len(one), one[0])) for one in held])


# Asked for again with every scene, and half a second for hundreds of spheres.
@lru_cache(maxsize=16)
def grouped(arm: SerialArm, count: int) -> Grouping:
    """The spheres of an arm in groups of one part each: the largest is halved until there are enough."""
    if np.count_nonzero(arm.sphere_links()) < 2:
        raise ScenarioError("the arm has no shape", expected="two spheres or more on links that move")
    count = min(max(count, len(arm.parts)), arm.sphere_count)
    spheres = arm.spheres_m()
    members = [np.arange(*span) for span in arm.sphere_ranges().tolist()]
    held = [_holding(spheres[one]) for one in members]
    while len(members) < count:
        sizes = [sphere[3] if len(one) > 1 else -1.0 for one, sphere in zip(members, held, strict=True)]
        at = int(np.argmax(sizes))
        spread = spheres[members[at], :3] - spheres[members[at], :3].mean(axis=0)
        along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
        order = members[at][np.argsort(along, kind="stable")]
        halves = [np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])]
        members[at : at + 1] = halves
        held[at : at + 1] = [_holding(spheres[one]) for one in halves]
    groups = np.empty(len(spheres), dtype=np.int64)
    for number, one in enumerate(members):
        groups[one] = number
    links = arm.sphere_links()[[one[0] for one in members]]
    return Grouping(links, np.stack(held), groups)


def _holding(spheres: NDArray[np.float64]) -> NDArray[np.float64]:
    """A sphere (4,) round spheres (n, 4): from the middle of their box, moved while it shrinks."""
    centres, radii = spheres[:, :3], spheres[:, 3]
    middle = ((centres - radii[:, None]).min(axis=0) + (centres + radii[:, None]).max(axis=0)) / 2.0
    # Towards what sticks out the most, by less and less (Badoiu and Clarkson's core sets).
    for step in range(1, 200):
        reach = np.linalg.norm(centres - middle, axis=1) + radii
        middle = middle + (centres[int(np.argmax(reach))] - middle) / (step + 1.0) ** 1.5
    return np.append(middle, (np.linalg.norm(centres - middle, axis=1) + radii).max())
