"""What is compared on which problems, and the record of one run."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import Annotated

from cspace.planning.query import DEFAULT_WAYS
from cspace.splits import Split
from cspace.world import World
from cspace.worlds import partly_seen, workshop_of
from cspace.worlds.unseen import Asked, PartlySeen, Taken
from services.evaluator.benchmark.store import Record
from services.evaluator.evaluation.units import planner_seed
from services.planner.settings import SAMPLED_CONNECT, PlannerSettings

# Of a problem whose start or goal collides, which nobody is asked to solve.
NO_PROBLEM = "start or goal collides"


@dataclass(frozen=True, slots=True)
class PlanRun(Record):
    """One run, each column with what it holds; empty where it does not fit the table of the arm."""

    table: Annotated[str, "without exact checks, or with exact checks"]
    source: Annotated[str, "where the problem comes from"]
    family: Annotated[str, "of the problem"]
    problem: Annotated[int, "its number within family and split"]
    pictures: Annotated[int, "by which the scene is seen; 0 for arms to which they do not matter"]
    run: Annotated[int, "number of the run on this problem"]
    arm: Annotated[str, "name of the way to plan"]
    sampler: Annotated[str | None, "the model that plans; empty for none"]
    status: Annotated[str, "solved; refused, without a way; timeout; or why a search with checks ended"]
    solved: Annotated[bool, "whether there is a way; with exact checks, one that is free"]
    confidence: Annotated[float | None, "that the whole way is free, as the model has it"]
    clearance_m: Annotated[
        float | None, "least of the way in truth, by spheres each 0.01 rad; 0 or less collides"
    ]
    meshes_free: Annotated[
        bool | None, "whether the way is free by meshes; empty where these are not installed"
    ]
    unseen: Annotated[float | None, "share of the arm that no picture shows, mean along the way"]
    length_rad: Annotated[float | None, "of the way, Euclidean"]
    search_s: Annotated[float, "looking for ways without exact checks"]
    score_s: Annotated[float, "of the model, asked about them"]
    request_s: Annotated[float, "all until the ways were there, the reading of the picture among it"]
    as_is: Annotated[bool | None, "whether one of the ways was free as it was"]
    state_checks: Annotated[int | None, "states looked at in truth"]
    edge_checks: Annotated[int | None, "motions checked in truth"]
    iterations: Annotated[int | None, "states drawn by RRT-Connect"]
    solve_s: Annotated[float | None, "wall time of the search with exact checks"]
    state_check_s: Annotated[float | None, "what a look at a state takes by spheres, on this problem"]
    mesh_check_s: Annotated[float | None, "the same by convex meshes; empty where these are not installed"]

    @property
    def key(self) -> tuple[str, int, int, int, str]:
        """Family, problem, pictures, run and arm."""
        return self.family, self.problem, self.pictures, self.run, self.arm


# Of each own family, where nothing else is asked for.
PROBLEMS = 30
# Searches that are checked exactly, of each problem.
RUNS = 3
PICTURES = (1, 2, 3)
AIMS = ("goal", "scene")
WAYS = DEFAULT_WAYS
PLAN_LIMIT_S, CHECKED_LIMIT_S, CHECKED_ITERATIONS = 2.0, 20.0, 200_000


class Table(StrEnum):
    """What an arm is measured for."""

    UNCHECKED = "without exact checks"
    CHECKED = "with exact checks"


@dataclass(frozen=True, slots=True)
class PlanArm:
    """A way to plan.

    Args:
        name: unique.
        table: that it stands in.
        sampler: the model that plans; None for none.
        taken: what unseen space is taken to be where no model is asked; None for checks alone, without ways.
    """

    name: str
    table: Table
    sampler: str | None = None
    taken: Taken | None = None

    @property
    def pictured(self) -> bool:
        """Whether pictures matter to it."""
        return self.sampler is not None or self.taken not in (None, Taken.KNOWN)


BASE = PlanArm("RRT-Connect, uniform", Table.CHECKED)
TRUE_WAYS = PlanArm("RRT-Connect, ways of the truth", Table.CHECKED, taken=Taken.KNOWN)


def arms_of(samplers: Sequence[str]) -> tuple[PlanArm, ...]:
    """All arms, for models of these names."""
    return (
        *(PlanArm(name, Table.UNCHECKED, name) for name in samplers),
        *(PlanArm(taken.value, Table.UNCHECKED, taken=taken) for taken in Taken),
        BASE,
        TRUE_WAYS,
        *(PlanArm(f"RRT-Connect, ways of {name}", Table.CHECKED, name) for name in samplers),
    )


def in_order(names: Iterable[str]) -> list[str]:
    """Names of arms of one table as its rows stand: uniform samples, those of models, all others."""
    others = [arm.name for arm in arms_of(())]
    return sorted(names, key=lambda name: (name != BASE.name, others.index(name) if name in others else -1))


@dataclass(frozen=True, slots=True)
class PlanSetting:
    """What all runs have in common; runs of another setting are never mixed with them.

    Args:
        protocol: its name.
        split: of the problems.
        seed: of problems, pictures of drawn ones, ways and planners.
        aim: what cameras look at, ``goal`` or ``scene``.
        plan_limit_s: for a search for ways.
        ways: that are looked for.
        checked_limit_s: for a search with exact checks.
        max_iterations: states drawn after which that ends.
        world: robot and sensor.
    """

    protocol: str
    split: Split
    seed: int
    aim: str
    plan_limit_s: float
    ways: int
    checked_limit_s: float
    max_iterations: int
    world: World

    @property
    def seen(self) -> PartlySeen:
        """Its problems."""
        return partly_seen(self.world)

    def asked(self, folder: Path | None) -> Asked:
        """Which of them, where those are in a folder that do not ship."""
        return Asked(self.split, self.seed, self.aim, folder)

    def planner(self, index: int, run: int) -> PlannerSettings:
        """Of a search with exact checks."""
        measures = workshop_of(self.world).measures
        return PlannerSettings(
            planner=SAMPLED_CONNECT,
            range_rad=measures.range_rad,
            resolution_rad=measures.resolution_rad,
            time_limit_s=self.checked_limit_s,
            max_iterations=self.max_iterations,
            seed=planner_seed(self.seed, index, run),
        )


@dataclass(frozen=True, slots=True)
class PlanUnit:
    """A problem as so many pictures show it, with what is still to be run: what one process does at a time.

    Args:
        family: of the problem.
        index: of the problem within its family.
        pictures: 0 for arms to which they do not matter.
        runs: of each arm, their numbers.
        folder: of problems that do not ship.
    """

    family: str
    index: int
    pictures: int
    runs: tuple[tuple[PlanArm, tuple[int, ...]], ...]
    folder: Path | None = None


Key = tuple[str, int, int, int, str]


def plan_units(
    problems: Mapping[str, int],
    pictures: Sequence[int],
    runs: int,
    arms: Sequence[PlanArm],
    done: set[Key],
    folder: Path | None,
) -> Iterator[PlanUnit]:
    """What is still to be done, problem by problem.

    Args:
        problems: how many of each family.
        pictures: by how many each is seen, in turn.
        runs: with exact checks, of each problem.
        arms: that are compared.
        done: family, problem, pictures, run and arm of the runs that there are.
        folder: of problems that do not ship.
    """
    for family, count in problems.items():
        for index, seen_by in product(range(count), (0, *pictures)):
            missing = []
            for arm in arms:
                numbers = range(runs if arm.table is Table.CHECKED else 1)
                left = tuple(run for run in numbers if (family, index, seen_by, run, arm.name) not in done)
                if left and arm.pictured == (seen_by > 0):
                    missing.append((arm, left))
            if missing:
                yield PlanUnit(family, index, seen_by, tuple(missing), folder)
