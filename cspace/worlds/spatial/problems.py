"""Planning problems of the spatial world, the paths that solve them, and configurations to learn from."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.planning.paths import length_rad, spaced
from cspace.planning.rrt_connect import Growth, grow_connect
from cspace.simulator import Proposals, Split, near_contact, scenario_rng
from cspace.worlds.spatial.arm import SerialArm, ready_rad
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import GoalRegion, Layout, SpatialScenes
from cspace.worlds.spatial.kinematics import Solving, solve_pose
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.scenes import draw_layout

# Longest step of a tree, the sum over the joints. Between states that are looked at, the largest over the
# joints: of trees, of shortcuts (finer, so that what is returned touches nothing), and of what is returned.
_RANGE_RAD, _SEARCH_RAD, _SHORTCUT_RAD, _FINAL_RAD = 2.0, 0.02, 0.005, 0.01


@dataclass(frozen=True, slots=True)
class PathLimits:
    """How long paths are searched for."""

    states: int = 16000  # uniform ones that the first try draws at most; the others draw a quarter of them
    tries: int = 6  # paths that the shortest is chosen from; fewer where one of the others fails
    shortcuts: int = 40
    polish: int = 200
    step_rad: float = 0.1


def find_path(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike,
    rng: np.random.Generator,
    limits: PathLimits = PathLimits(),
) -> NDArray[np.float64] | None:
    """A short path (k, d) rad between free (d,), every edge free at 0.01 rad; None where none is found."""
    if not (checker.valid(start) and checker.valid(goal)):
        return None
    ends = checker.space.wrap(np.stack([np.asarray(one, dtype=np.float64) for one in (start, goal)]))
    straight = _checked(checker, ends, limits.step_rad)
    if straight is not None:
        return straight
    found: list[NDArray[np.float64]] = []
    for index in range(limits.tries):
        states = checker.space.sample_uniform(rng, limits.states if index == 0 else limits.states // 4)
        raw = grow_connect(checker, ends[0], ends[1], states, Growth(_RANGE_RAD, _SEARCH_RAD)).path
        if raw is None:
            break
        short = checker.shortened(raw, rng, limits.shortcuts, _SHORTCUT_RAD)
        found += [path for path in (short, raw) if is_free(checker, path)][:1]
    for path in sorted(found, key=lambda one: length_rad(one, checker.space)):
        polished = checker.shortened(path, rng, limits.polish, _SHORTCUT_RAD)
        for one in (polished, path):
            spaced = _checked(checker, one, limits.step_rad)
            if spaced is not None:
                return spaced
    return None


def is_free(checker: CollisionChecker, path: NDArray[np.float64]) -> bool:
    """Whether all edges of a path (k, d) rad are free, at every 0.01 rad."""
    return bool(checker.edge_batch(path[:-1], path[1:], _FINAL_RAD).all())


def _checked(
    checker: CollisionChecker, path: NDArray[np.float64], step_rad: float
) -> NDArray[np.float64] | None:
    """The path in even steps, None where one of these is not free."""
    found = spaced(path, checker.space, step_rad)
    return found if is_free(checker, found) else None


KINDS = ("reach_in", "between", "carry")
SHARES = (0.5, 0.3, 0.2)
CONE_RAD = float(np.radians(25.0))
MAX_DRAWS = 60
# Ends that are tried in a scene before the next one, and the least distance between their tools.
_ENDS, _MIN_DISTANCE_M = 4, 0.15
_HOME_SIGMA_RAD, _HOMES = 0.25, 24
# Of the tool's origin, and how many places in a region are looked at.
_ROOM_M, _PLACES = 0.02, 64
_SOLVING = Solving(starts=6)
# Share of the problems that the straight path solves; the others are kept all.
_TRIVIAL_KEPT = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class SpatialProblem:
    """A planning problem and a path that solves it."""

    layout: Layout
    start: NDArray[np.float64]  # (d,) rad
    goal: NDArray[np.float64]  # (d,) rad
    kind: str
    path: NDArray[np.float64]  # (k, d) rad from start to goal, every edge free at 0.01 rad
    rejected: int  # draws of start and goal before this one


def draw_problem(
    arm: SerialArm,
    scenes: SpatialScenes,
    split: Split,
    seed: int,
    index: int,
    family: str | None = None,
    limits: PathLimits = PathLimits(),
) -> SpatialProblem:
    """A problem that :func:`find_path` solved, of what split, seed and index say."""
    # A child, for the scene is drawn from the same three values.
    (rng,) = scenario_rng(split, seed, index).spawn(1)
    kind, rejected = _any_kind(rng), 0
    for number in range(MAX_DRAWS):
        scene_seed = seed if number == 0 else int(rng.integers(2**62))
        layout = draw_layout(scenes, split, scene_seed, index, family)
        ends = Ends(CollisionChecker(arm, layout.obstacles), layout.regions, rng)
        for _ in range(_ENDS):
            pair = ends.pair(kind)
            path = None if pair is None else find_path(ends.checker, *pair, rng, limits)
            if path is not None:
                path.setflags(write=False)
                return SpatialProblem(layout, path[0], path[-1], kind, path, rejected)
            rejected += 1
    raise ScenarioError(
        f"no problem of the kind {kind} was found in {MAX_DRAWS} scenes of {family or 'any family'}"
    )


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
        """At most so many starts and goals (2, d) rad of any kind; the arm waits at a state (d,) if given."""
        for _ in range(count):
            pair = self.pair(_any_kind(self.rng), state)
            if pair is not None:
                yield np.stack(pair)

    def pair(
        self, kind: str, state: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Start and goal; None where one is missing, or the straight path makes it too easy."""
        goal = self.reaching()
        if goal is None:
            return None
        home = self.home if state is None else lambda: state
        start = {"reach_in": home, "between": self.reaching, "carry": self.elsewhere}[kind]()
        if start is None:
            return None
        first, second = self.arm.tool_frames(np.stack([start, goal]))[:, :3, 3]
        if np.linalg.norm(first - second) < _MIN_DISTANCE_M:
            return None
        if kind == "carry":
            start, goal = goal, start
        if self.checker.edge(start, goal, _FINAL_RAD) and self.rng.random() >= _TRIVIAL_KEPT:
            return None
        return start, goal

    def home(self) -> NDArray[np.float64] | None:
        space = self.arm.space
        ready = ready_rad(self.arm)
        homes = ready + self.rng.normal(size=(_HOMES, self.arm.dim)) * _HOME_SIGMA_RAD
        return self._first_free(space.wrap(homes[space.contains(homes)]))

    def reaching(self) -> NDArray[np.float64] | None:
        """A hand in one of the regions, each as likely to be tried first."""
        for number in self.rng.permutation(len(self.regions)):
            region = self.regions[number]
            found = self._with_tool_at(region.draw(self.rng, _PLACES), np.asarray(region.approach))
            if found is not None:
                return found
        return None

    def elsewhere(self) -> NDArray[np.float64] | None:
        """A hand that hangs down over no region in particular, or any configuration."""
        if self.rng.random() < 0.5:
            return self._first_free(self.arm.space.sample_uniform(self.rng, _PLACES))
        bearing = self.rng.uniform(-np.pi, np.pi, _PLACES)
        away, height = self.rng.uniform((0.3, 0.0), (0.8, 0.8), (_PLACES, 2)).T * self.arm.reach_m
        places = np.stack([away * np.cos(bearing), away * np.sin(bearing), height], axis=1)
        return self._with_tool_at(places, np.array([0.0, 0.0, -1.0]))

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


def _in_cone(rng: np.random.Generator, axis: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    """A unit vector, uniform within an angle of another, (3,)."""
    cosine = rng.uniform(np.cos(angle_rad), 1.0)
    sideways = np.cross(axis, rng.normal(size=3))
    along = cosine * axis + np.sqrt(1.0 - cosine**2) * sideways / np.linalg.norm(sideways)
    return np.asarray(along / np.linalg.norm(along))


# Of each origin but the first, which gets the rest.
ORIGIN_SHARES = (0.2, 0.25, 0.15, 0.2)
NEAR_M, NEAR_SIGMA_RAD = 0.06, 0.05
# About an end are half of them near by, half farther away; beside a path they are near.
END_SIGMAS_RAD, PATH_SIGMA_RAD = (0.12, 0.3), 0.1
GOALS = 4
# Of the obstacles, that a mistaken planner knows; its paths are looked at where they are.
KNOWN_SHARES, MISTAKEN_SIGMA_RAD = (0.0, 0.4, 0.8), 0.03
# One short path to each goal is enough to be beside.
_LIMITS = PathLimits(states=1500, tries=1, shortcuts=40, polish=0, step_rad=0.2)


def draw_proposals(
    checker: CollisionChecker,
    regions: Sequence[GoalRegion],
    start: NDArray[np.float64] | None,
    rng: np.random.Generator,
    count: int,
) -> Proposals:
    """So many configurations, uniform ones first, about a start (d,) rad where the arm waits."""
    space = checker.space
    counts = [int(share * count) for share in ORIGIN_SHARES]
    anywhere = space.sample_uniform(rng, count - sum(counts))
    near = near_contact(checker, rng, counts[0], NEAR_M, NEAR_SIGMA_RAD)
    sampler = Ends(checker, regions, rng)
    found = [sampler.home() if start is None else start, *(sampler.reaching() for _ in range(GOALS))]
    known = [one for one in found if one is not None]
    ends = np.stack(known) if known else space.sample_uniform(rng, 1)
    sigmas = np.asarray(END_SIGMAS_RAD)[rng.integers(len(END_SIGMAS_RAD), size=counts[1])]
    about = _about(checker, ends, sigmas, rng)
    # The ends alone where there is no path.
    paths = [find_path(checker, ends[0], goal, rng, _LIMITS) for goal in ends[1:]]
    along = np.concatenate([ends, *(path for path in paths if path is not None)])
    beside = _about(checker, along, np.full(counts[2], PATH_SIGMA_RAD), rng)
    mistaken = _about(checker, _mistaken(checker, ends, rng), np.full(counts[3], MISTAKEN_SIGMA_RAD), rng)
    rows = (anywhere, near, about, beside, mistaken)
    origins = np.repeat(np.arange(len(rows), dtype=np.uint8), [len(part) for part in rows])
    return Proposals(np.concatenate(rows), origins)


def _mistaken(
    checker: CollisionChecker, ends: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """States of paths that are free of some of the obstacles alone, (n, d) rad, evenly spaced."""
    found = [ends]
    for share in KNOWN_SHARES:
        some = Obstacles.of(one for one in checker.obstacles.shapes if rng.random() < share)
        known = CollisionChecker(checker.arm, some)
        first, last = ends[rng.integers(len(ends))], ends[rng.integers(len(ends))]
        path = find_path(known, first, last, rng, _LIMITS)
        found += [] if path is None else [path]
    return np.concatenate(found)


def _about(
    checker: CollisionChecker,
    centres: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """A configuration near one of (k, d) rad for each sigma."""
    rows = centres[rng.integers(len(centres), size=len(sigmas))]
    return checker.space.bound(rows + rng.normal(size=rows.shape) * sigmas[:, None])
