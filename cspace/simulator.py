"""What a simulator does: scenes of a world, their pictures, collision checks and planning problems."""

import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.space import JointSpace
from cspace.world import Image, Scene, World

# Families of problems: ends anywhere, which every world has; ends that a narrow passage joins and nothing
# wider; problems that somebody made by hand.
UNIFORM, NARROW, OWN = "uniform", "narrow", "own"


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem."""

    scenario: Scene
    start: NDArray[np.float64]  # (d,) rad
    goal: NDArray[np.float64]  # (d,) rad
    family: str = OWN
    bottleneck_rad: float = math.nan  # largest clearance that joins start and goal; 0 without a path, or NaN
    seed: int = 0
    rejected: int = 0  # draws before it that were not of the family

    @property
    def passage(self) -> str:
        """The bottleneck in words; nothing where it is not known."""
        if math.isnan(self.bottleneck_rad):
            return ""
        if math.isinf(self.bottleneck_rad):
            return "nothing in reach"
        return f"bottleneck {self.bottleneck_rad:.3f} rad" if self.bottleneck_rad > 0.0 else "no path"

    @property
    def space(self) -> JointSpace:
        return self.scenario.world.space


class Split(StrEnum):
    """What a scenario may be used for."""

    TRAIN = "train"
    VALIDATION = "validation"
    TEST = "test"
    DEMO = "demo"


_SPLIT_KEYS = {Split.TRAIN: 1, Split.VALIDATION: 2, Split.TEST: 3, Split.DEMO: 4}


def scenario_rng(split: Split, seed: int, index: int) -> np.random.Generator:
    """The random generator of one scenario; independent over splits, seeds and indices."""
    return np.random.default_rng(
        np.random.SeedSequence(entropy=seed, spawn_key=(_SPLIT_KEYS[Split(split)], index))
    )


def derived_seed(seed: int, *use: str) -> int:
    """A seed of 63 bits for one use of a seed; independent over seeds and uses."""
    key = np.frombuffer(hashlib.sha256("/".join(use).encode()).digest()[:16], dtype=np.uint32)
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=tuple(int(word) for word in key))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


# Shares of a path's length that shortcuts span are sampled down to this, evenly by their logarithm.
SHORTEST_SPAN = 0.02
EdgeTest = Callable[[NDArray[np.float64], NDArray[np.float64]], tuple[bool, int]]
# A free path (k, d) rad between two free configurations (d,) rad, or None where none is found.
PathSearch = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64] | None]


class Checker:
    """Compiled collision checks of one scene. Edges are straight, on the shorter side of a circle."""

    def __init__(self, space: JointSpace, scene: Any, kernels: Any) -> None:
        self.space, self.scene, self.kernels = space, scene, kernels

    def valid(self, configuration: ArrayLike) -> bool:
        """Whether one configuration (d,) rad is free."""
        return bool(self.valid_batch(np.atleast_2d(np.asarray(configuration, dtype=np.float64)))[0])

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""
        return np.asarray(self.kernels.free_batch(self._rows(configurations), self.scene))

    def clearance(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Distance to what the robot collides with for each of (N, d) rad, (N,) m; negative in collision."""
        return np.asarray(self.kernels.clearance_batch(self._rows(configurations), self.scene))

    def edge(self, start: ArrayLike, end: ArrayLike, resolution_rad: float) -> bool:
        """Whether the edge between two configurations (d,) rad is free."""
        first, second = (np.atleast_2d(np.asarray(q, dtype=np.float64)) for q in (start, end))
        return bool(self.edge_batch(first, second, resolution_rad)[0])

    def edge_batch(self, starts: ArrayLike, ends: ArrayLike, resolution_rad: float) -> NDArray[np.bool_]:
        """Which of the edges between (N, d) and (N, d) rad are free, both ends included, (N,)."""
        first, second = self._rows(starts), self._rows(ends)
        return np.asarray(self.kernels.edge_batch(first, second, float(resolution_rad), self.scene))

    def within(self, space: JointSpace) -> "Checker":
        """The same checks, for a space with narrower limits; see :meth:`JointSpace.narrowed`."""
        found = copy(self)
        found.space = space
        found.scene = self.scene._replace(
            lower=np.asarray(space.lower, dtype=np.float64),
            upper=np.asarray(space.upper, dtype=np.float64),
            periodic=np.asarray(space.periodic, dtype=np.bool_),
        )
        return found

    def edge_test(self, resolution_rad: float) -> EdgeTest:
        """For callbacks: whether an edge is free, and how many states were checked."""
        kernel, scene, room = self.kernels.checked_edge, self.scene, self.kernels.room_of(self.scene)

        def check(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[bool, int]:
            found: tuple[bool, int] = kernel(start, end, resolution_rad, scene, room)
            return found

        # A process's first call loads the compiled kernel, which is no part of a search.
        check(np.zeros(self.space.dim), np.zeros(self.space.dim))
        return check

    def grow_trees(
        self,
        nodes: NDArray[np.float64],
        parents: NDArray[np.int64],
        counts: NDArray[np.int64],
        checks: NDArray[np.int64],
        states: NDArray[np.float64],
        side: int,
        range_rad: float,
        resolution_rad: float,
    ) -> tuple[int, int, int, int]:
        """Grow RRT-Connect's trees in place by a block of sampled states (n, d).

        ``nodes``: (2, m, d) rad. ``parents``: (2, m), -1 for roots. ``counts``, ``checks``: (2,). Returns
        iterations done, whose turn it is, and the node that both trees share, -1 twice without one.
        """
        grown: tuple[int, int, int, int] = self.kernels.grow_trees(
            nodes, parents, counts, checks, states, side, range_rad, resolution_rad, self.scene
        )
        return grown

    def shortened(
        self, path: ArrayLike, rng: np.random.Generator, shortcuts: int, resolution_rad: float
    ) -> NDArray[np.float64]:
        """The path (k, d) rad with free pieces straight between random points where these are shorter."""
        rows = np.array(path, dtype=np.float64)
        draws = rng.random((shortcuts, 2))
        # Spans of all sizes: corners are cut by short ones, detours by long ones.
        draws[:, 1] = SHORTEST_SPAN ** draws[:, 1]
        return np.asarray(self.kernels.shortened(rows, draws, resolution_rad, self.scene))

    def _rows(self, configurations: ArrayLike) -> NDArray[np.float64]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        # Compiled code does not look where its arrays end.
        if rows.ndim != 2 or rows.shape[1] != self.space.dim:
            raise ScenarioError(f"configurations (N, {self.space.dim}) were expected", got=str(rows.shape))
        return rows


@dataclass(frozen=True, slots=True)
class Families:
    """The families of planning problems that a world has."""

    names: tuple[str, ...]
    solvable: tuple[str, ...]
    decisive: str
    note: str
    uniform_obstacles: str

    @property
    def unsolvable(self) -> tuple[str, ...]:
        return tuple(name for name in self.names if name not in self.solvable)


@dataclass(frozen=True, slots=True)
class Measures:
    """Numbers that fit one world: how samples and plans are measured there, and what its training assumes."""

    coverage_radius_rad: float
    near_contact_m: float
    range_rad: float  # longest step of a planner's tree, the sum over the joints
    resolution_rad: float
    # Least share of what as many real samples cover for a promotion; None where balls do not measure coverage
    coverage_share: float | None
    # How much worse than the best champion a version may be, by metric
    margins: Mapping[str, float]
    path_margins: Mapping[str, float]
    free_share: float


# Where proposals lie; mistaken paths are free of some obstacles alone.
ORIGINS = ("uniform", "near contact", "about ends", "along paths", "along mistaken paths")


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """Configurations of a scene that are worth labelling, free ones and others."""

    configurations: NDArray[np.float64]  # (n, d) rad, within the limits
    origins: NDArray[np.uint8]  # (n,) uint8, places in :data:`ORIGINS`


def near_contact(
    checker: Checker, rng: np.random.Generator, count: int, within_m: float, sigma_rad: float
) -> NDArray[np.float64]:
    """Configurations near to touching something: uniform ones that are, and some way off, (count, d) rad."""
    space = checker.space
    anywhere = space.sample_uniform(rng, max(256, 8 * count))
    near = anywhere[np.abs(checker.clearance(anywhere)) <= within_m]
    chosen = near if len(near) else anywhere
    rows = chosen[rng.integers(len(chosen), size=count)]
    return space.bound(rows + rng.normal(size=rows.shape) * sigma_rad)


class Simulator(ABC):
    """Makes scenes of a world, shows and checks them; each kind has a frozen dataclass of its world."""

    world: World

    @property
    @abstractmethod
    def families(self) -> Families: ...

    @property
    @abstractmethod
    def measures(self) -> Measures: ...

    @abstractmethod
    def scene(self, rng: np.random.Generator, split: Split, index: int) -> Scene:
        """A scene of a split; where scenes are given, the index-th of them."""

    def scenes(self, split: Split, seed: int, count: int) -> Sequence[Scene]:
        """The first ``count`` of a split under a seed, no given one twice; a longer list starts alike."""
        there = self.count(split)
        count = count if there is None else min(count, there)
        return [self.scene(scenario_rng(split, seed, index), split, index) for index in range(count)]

    @abstractmethod
    def arrays_of(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """A scene's geometry as rows of a data set's arrays, by their names."""

    @abstractmethod
    def render(self, scene: Scene) -> Image: ...

    @abstractmethod
    def picture_file(self, scene: Scene) -> bytes:
        """The file that :meth:`cspace.world.World.read_picture` reads as its picture."""

    @abstractmethod
    def checker(self, scene: Scene) -> Checker: ...

    @abstractmethod
    def proposals(self, scene: Scene, rng: np.random.Generator, count: int) -> Proposals:
        """So many configurations of a scene that a head learns from, uniform ones first."""

    def require(self, family: str) -> None:
        names = self.families.names
        if family not in names:
            raise ScenarioError("there is no such family", expected=f"one of {', '.join(names)}", got=family)

    def narrow_pairs(self, scene: Scene, configurations: NDArray[np.float64]) -> NDArray[np.int64]:
        """Pairs (k, 2) of free configurations (n, d) rad that a narrow passage joins and nothing wider."""
        del scene, configurations
        return np.empty((0, 2), dtype=np.int64)

    @abstractmethod
    def ends(
        self, scene: Scene, free: NDArray[np.float64], rng: np.random.Generator, count: int
    ) -> Iterable[NDArray[np.float64]]:
        """At most so many starts and goals as problems of a scene have them, each (2, d) rad and free."""

    @abstractmethod
    def path_search(self, scene: Scene) -> PathSearch:
        """Near-optimal paths of a scene that is known in full."""

    @abstractmethod
    def problem(self, family: str, split: Split, seed: int, index: int = 0) -> Problem: ...

    def obstruction(self, problem: Problem) -> str | None:
        """Why a problem has no solution, in words; None where that is not known."""
        clearances = self.checker(problem.scenario).clearance([problem.start, problem.goal])
        for name, clearance_m in zip(("start", "goal"), clearances, strict=True):
            if clearance_m <= 0.0:
                return f"the {name} is {-clearance_m:.3f} m deep in collision"
        return None

    def count(self, split: Split) -> int | None:
        """How many scenes a split has; None where they are drawn without end."""
        del split
        return None

    @abstractmethod
    def draw_picture(self, axes: Any, picture: Image) -> None:
        """What a picture shows, on axes of matplotlib, with their labels."""

    @abstractmethod
    def draw_scene(self, axes: Any, scene: Scene, colour: str) -> None:
        """Obstacles and frame, on axes of matplotlib."""

    @abstractmethod
    def draw_robot(self, axes: Any, configuration: ArrayLike, colour: str, order: int) -> None:
        """The robot at a configuration (d,) rad."""

    @abstractmethod
    def drawn_joints_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Where base, joints and tip are drawn at configurations (N, d) rad, (N, k, 2)."""


class UnseenPolicy(StrEnum):
    """What a planner takes the space to be that no picture shows; what is seen stays as it is seen."""

    FREE = "unseen is free"
    OCCUPIED = "unseen is occupied"
    CLEARED = "unseen is occupied, goal cleared"
    TRUE = "truth where unseen"
    KNOWN = "truth everywhere"


@dataclass(frozen=True, slots=True)
class ProblemRequest:
    """Which problems are requested, and how they are seen."""

    split: Split
    seed: int = 0
    folder: Path | None = None  # of problems that do not ship; None where none are needed
