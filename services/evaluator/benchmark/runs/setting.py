"""Under which limits the benchmark's runs are made, and which runs there are."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import product

from cspace.splits import Split
from cspace.workshop import Families
from cspace.world import World
from cspace.worlds import default_world, workshop_of
from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.evaluation.units import planner_seed
from services.planner.settings import PlannerSettings


class Protocol(StrEnum):
    """How much is run on what.

    ``families``: many problems of every family, once each, to a limit of iterations. ``paper``: few problems,
    many times each, to a limit of wall time. ``plans``: ways through scenes that pictures show in part; see
    :mod:`services.evaluator.benchmark.plans`.
    """

    FAMILIES = "families"
    PAPER = "paper"
    PLANS = "plans"


@dataclass(frozen=True, slots=True)
class Setting:
    """What all runs of a benchmark have in common; runs of another setting are never mixed with them.

    Args:
        protocol: how much is run on what.
        split: of the scenarios.
        seed: of problems, planners and samplers.
        max_iterations: states drawn after which a search ends without a path.
        optimising_iterations: the same for a search that goes on after its first solution.
        time_limit_s: wall time after which a search ends.
        resolution_rad: largest distance between checked states of an edge in any joint, rad.
        goal_bias: of planners that have one.
        world: robot and sensor.
    """

    protocol: Protocol
    split: Split
    seed: int
    max_iterations: int
    optimising_iterations: int
    time_limit_s: float
    resolution_rad: float
    goal_bias: float = 0.05
    world: World = field(default_factory=default_world)

    @property
    def families(self) -> Families:
        """Of the world's problems."""
        return workshop_of(self.world).families

    def planner(self, arm: Arm, index: int, run: int) -> PlannerSettings:
        """The settings of one run; the seed is the same for every arm."""
        return PlannerSettings(
            planner=arm.planner,
            range_rad=arm.range_rad,
            resolution_rad=self.resolution_rad,
            goal_bias=self.goal_bias,
            time_limit_s=self.time_limit_s,
            max_iterations=self.max_iterations if arm.stop_at_first else self.optimising_iterations,
            seed=planner_seed(self.seed, index, run),
            stop_at_first=arm.stop_at_first,
            colliding_last=arm.colliding_last,
        )


LIMITS: Mapping[Protocol, Mapping[str, float]] = {
    Protocol.FAMILIES: {"max_iterations": 20_000, "optimising_iterations": 2000, "time_limit_s": 10.0},
    # The paper stops by the clock alone; so many iterations no planner here makes in a second.
    Protocol.PAPER: {"max_iterations": 200_000, "optimising_iterations": 200_000, "time_limit_s": 1.0},
}
RUNS = {Protocol.FAMILIES: 1, Protocol.PAPER: 100}

Key = tuple[str, int, int, str]


def problems_of(protocol: Protocol, families: Families) -> dict[str, int]:
    """How many problems of each family a protocol has, in the order in which they are run.

    A problem without a path takes every arm to its limit, about a minute in all.
    """
    if protocol is Protocol.PAPER:
        return dict.fromkeys(families.solvable, 10)
    solvable = dict.fromkeys((families.telling, *families.solvable), 300)
    return solvable | dict.fromkeys(families.unsolvable, 30)


@dataclass(frozen=True, slots=True)
class Unit:
    """One run of one problem with some arms: what one process does at a time.

    Args:
        family: of the problem.
        index: of the problem within its family.
        run: its number.
        arms: that are still to be run.
    """

    family: str
    index: int
    run: int
    arms: tuple[Arm, ...]


def units(
    problems: Mapping[str, int], runs: int, arms: Sequence[Arm], done: set[Key], families: Families
) -> Iterator[Unit]:
    """What is still to be done, problem by problem.

    Without a path there is none to shorten, so problems that have none have no optimising arms.

    Args:
        problems: how many of each family.
        runs: of each problem.
        arms: for each run.
        done: family, problem, run and arm of the runs that there are.
        families: of the world.
    """
    for family, count in problems.items():
        mine = [arm for arm in arms if arm.stop_at_first or family in families.solvable]
        for index, run in product(range(count), range(runs)):
            missing = tuple(arm for arm in mine if (family, index, run, arm.name) not in done)
            if missing:
                yield Unit(family, index, run, missing)
