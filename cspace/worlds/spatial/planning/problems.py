"""Planning problems of the spatial world: seeded start and goal by kind, each with a way that solves it.

| kind | start and goal |
|---|---|
| ``reach_in`` | from about the ready pose to a hand that reaches into a region of the scene |
| ``between`` | from one such hand to another, in the same region or in another one |
| ``carry`` | from such a hand to one that hangs down elsewhere, or to any free configuration far from it |

A hand reaches in where the tool's origin is within the region's box and its z axis within 25 degrees of the
region's approach.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.splits import Split, scenario_rng
from cspace.worlds.spatial.obstacles.families import draw_layout
from cspace.worlds.spatial.obstacles.layout import GoalRegion, Layout
from cspace.worlds.spatial.obstacles.scenes import SpatialScenes
from cspace.worlds.spatial.obstacles.signed_distance import distance_m
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.planning.inverse import Solving, solve_pose
from cspace.worlds.spatial.planning.ways import WayLimits, find_way
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.ready import ready_rad

KINDS = ("reach_in", "between", "carry")
SHARES = (0.5, 0.3, 0.2)
CONE_RAD = float(np.radians(25.0))
MAX_DRAWS = 60
# Ends that are tried in a scene before the next one, and the least distance between their tools.
_ENDS, _APART_M = 4, 0.15
_HOME_SIGMA_RAD, _HOMES = 0.25, 24
# Of the tool's origin, and how many places in a region are looked at.
_ROOM_M, _PLACES = 0.02, 64
_SOLVING = Solving(starts=6)
# Share of the problems that the straight way solves; the others are kept all.
_TRIVIAL_KEPT = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class SpatialProblem:
    """A planning problem and a way that solves it.

    Args:
        layout: the scene.
        start: (d,) rad.
        goal: (d,) rad.
        kind: one of :data:`KINDS`.
        way: (k, d) rad from start to goal, every edge free at 0.01 rad.
        is_trivial: whether the straight way is free.
        rejected: draws of start and goal before this one.
    """

    layout: Layout
    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    kind: str
    way: NDArray[np.float64]
    is_trivial: bool
    rejected: int


def draw_problem(
    arm: SerialArm,
    scenes: SpatialScenes,
    split: Split,
    seed: int,
    index: int,
    family: str | None = None,
    *,
    kind: str | None = None,
    limits: WayLimits = WayLimits(),  # noqa: B008 - a frozen value
) -> SpatialProblem:
    """A problem that :func:`find_way` solved, of what split, seed and index say.

    Its scene is that of :func:`draw_layout` where that has one, else one drawn after it.

    Args:
        arm: with its spheres.
        scenes: the families of scenes.
        split: what the problem may be used for.
        seed: of the problem set.
        index: of the problem within it.
        family: of the scene; by chance where it is not named.
        kind: one of :data:`KINDS`; by chance where it is not named.
        limits: of the search for the way.

    Raises:
        ScenarioError: there is no such family or kind, or no problem was found in 60 scenes.
    """
    if kind is not None and kind not in KINDS:
        raise ScenarioError(
            "the kind of problem is unknown", expected=f"one of {', '.join(KINDS)}", got=kind[:200]
        )
    # A child, for the scene is drawn from the same three values.
    (rng,) = scenario_rng(split, seed, index).spawn(1)
    drawn = _any_kind(rng)
    rejected = 0
    for number in range(MAX_DRAWS):
        scene_seed = seed if number == 0 else int(rng.integers(2**62))
        layout = draw_layout(scenes, split, scene_seed, index, family)
        ends = Ends(CollisionChecker(arm, layout.obstacles), layout.regions, rng)
        for _ in range(_ENDS):
            found = _attempt(ends, kind or drawn, limits)
            if found is not None:
                way, is_trivial = found
                return SpatialProblem(layout, way[0], way[-1], kind or drawn, way, is_trivial, rejected)
            rejected += 1
    raise ScenarioError(
        f"no problem of the kind {kind or drawn} was found",
        expected=f"one in {MAX_DRAWS} scenes of {family or 'any family'}",
        got="none",
        remedy="other scenes, or another arm",
    )


def _attempt(ends: "Ends", kind: str, limits: WayLimits) -> tuple[NDArray[np.float64], bool] | None:
    """A way between two ends and whether it is straight; None where ends or way are missing, or too easy."""
    pair = ends.pair(kind, limits.final_rad)
    if pair is None:
        return None
    start, goal, is_trivial = pair
    way = find_way(ends.checker, start, goal, ends.rng, limits)
    if way is None:
        return None
    way.setflags(write=False)
    return way, is_trivial


def _any_kind(rng: np.random.Generator) -> str:
    return KINDS[int(rng.choice(len(KINDS), p=SHARES))]


class Ends:
    """Draws free ends of problems in one scene."""

    def __init__(
        self, checker: CollisionChecker, regions: Sequence[GoalRegion], rng: np.random.Generator
    ) -> None:
        self.checker, self.regions, self.rng = checker, regions, rng
        self.arm = checker.arm

    def pairs(self, count: int, state: NDArray[np.float64] | None) -> Iterator[NDArray[np.float64]]:
        """Starts and goals (2, d) rad of any kind from so many tries.

        Args:
            count: tries; those without ends, and most of those that the straight way solves, give none.
            state: (d,) rad, where the arm waits before it reaches in; None for about the ready pose.
        """
        for _ in range(count):
            pair = self.pair(_any_kind(self.rng), WayLimits().final_rad, state)
            if pair is not None:
                yield np.stack(pair[:2])

    def pair(
        self, kind: str, resolution_rad: float, state: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], bool] | None:
        """Start, goal and whether the straight way solves them; None where one is missing, or too easy."""
        goal = self.reaching()
        if goal is None:
            return None
        home = self.home if state is None else lambda: state
        start = {"reach_in": home, "between": self.reaching, "carry": self.elsewhere}[kind]()
        if start is None or not self.are_apart(start, goal):
            return None
        if kind == "carry":
            start, goal = goal, start
        is_trivial = self.checker.edge(start, goal, resolution_rad)
        if is_trivial and self.rng.random() >= _TRIVIAL_KEPT:
            return None
        return start, goal, is_trivial

    def home(self) -> NDArray[np.float64] | None:
        """About the ready pose."""
        space = self.arm.space
        ready = ready_rad(self.arm)
        homes = ready + self.rng.normal(size=(_HOMES, self.arm.dim)) * _HOME_SIGMA_RAD
        return self._first_free(space.wrap(homes[space.contains(homes)]))

    def reaching(self) -> NDArray[np.float64] | None:
        """A hand in one of the regions, each as likely to be tried first."""
        for number in self.rng.permutation(len(self.regions)):
            found = self.reaching_into(self.regions[number])
            if found is not None:
                return found
        return None

    def reaching_into(self, region: GoalRegion) -> NDArray[np.float64] | None:
        """A hand in one region."""
        return self._with_tool_at(region.draw(self.rng, _PLACES), np.asarray(region.approach))

    def elsewhere(self) -> NDArray[np.float64] | None:
        """A hand that hangs down over no region in particular, or any configuration."""
        if self.rng.random() < 0.5:
            return self._first_free(self.arm.space.sample_uniform(self.rng, _PLACES))
        bearing = self.rng.uniform(-np.pi, np.pi, _PLACES)
        away, height = self.rng.uniform((0.3, 0.0), (0.8, 0.8), (_PLACES, 2)).T * self.arm.reach_m
        places = np.stack([away * np.cos(bearing), away * np.sin(bearing), height], axis=1)
        return self._with_tool_at(places, np.array([0.0, 0.0, -1.0]))

    def are_apart(self, start: NDArray[np.float64], goal: NDArray[np.float64]) -> bool:
        """Whether the tool has some way to go."""
        first, second = self.arm.tool_frames(np.stack([start, goal]))[:, :3, 3]
        return bool(np.linalg.norm(first - second) >= _APART_M)

    def _with_tool_at(
        self, places: NDArray[np.float64], approach: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """The first free configuration whose tool is at one of (n, 3) m, its z axis within the cone."""
        room = distance_m(self.checker.obstacles, places) >= _ROOM_M
        near = np.linalg.norm(places, axis=1) <= self.arm.reach_m
        for place in places[room & near]:
            along = _in_cone(self.rng, approach, CONE_RAD - _SOLVING.turn_rad)
            solutions = solve_pose(self.arm, place, self.rng, approach=along, solving=_SOLVING)
            found = self._first_free(solutions)
            if found is not None:
                return found
        return None

    def _first_free(self, configurations: NDArray[np.float64]) -> NDArray[np.float64] | None:
        free = configurations[self.checker.valid_batch(configurations)]
        return free[0] if len(free) else None


def reaches_into(arm: SerialArm, configurations: ArrayLike, region: GoalRegion) -> NDArray[np.bool_]:
    """Which of (N, d) rad bring the tool into a region, (N,), to the tolerances of :class:`Solving`."""
    tools = arm.tool_frames(configurations)
    pose, half = np.array(region.box.pose), np.array(region.box.half_m)
    inside = np.abs((tools[:, :3, 3] - pose[:3, 3]) @ pose[:3, :3]) <= half + _SOLVING.place_m
    return np.asarray(inside.all(axis=1) & (tools[:, :3, 2] @ region.approach >= np.cos(CONE_RAD)))


def _in_cone(rng: np.random.Generator, axis: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    """A unit vector, uniform within an angle of another, (3,)."""
    cosine = rng.uniform(np.cos(angle_rad), 1.0)
    sideways = np.cross(axis, rng.normal(size=3))
    along = cosine * axis + np.sqrt(1.0 - cosine**2) * sideways / np.linalg.norm(sideways)
    return np.asarray(along / np.linalg.norm(along))
