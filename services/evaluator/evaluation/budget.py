"""How much is evaluated, cut into units of work that can run anywhere in any order with the same numbers."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from cspace.splits import Split
from cspace.workshop import Families
from services.evaluator.measures.topology.geometry_score import POINTS

JUDGED = (Split.VALIDATION, Split.TEST)


class Kind(StrEnum):
    """What a unit of work measures."""

    RECONSTRUCTION = "reconstruction"
    TOPOLOGY = "topology"
    PLANNING = "planning"


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is evaluated.

    Args:
        scenarios: per split, for reconstruction; they alone decide.
        samples: per scenario and sampler.
        validation_problems: planning problems per family that decide.
        test_problems: planning problems per family that are only reported.
        planner_seeds: runs per problem.
        topology_scenarios: of the test split, for GS and GS-C, which decide nothing.
        draws: of landmarks per cloud and turn.
        narrow_scenarios: per split, for reconstruction; those of the first planning problems of the family
            that tells most, as drawing one takes long, so no more than there are.
        disconnected_scenarios: per split, for reconstruction, of each family without a solution.
        topology_samples: points per cloud for GS and GS-C.
    """

    scenarios: int
    samples: int
    validation_problems: int
    test_problems: int
    planner_seeds: int
    topology_scenarios: int
    draws: int
    narrow_scenarios: int = 0
    disconnected_scenarios: int = 0
    topology_samples: int = POINTS


QUICK = Budget(60, 1000, 30, 10, 1, 3, 50, narrow_scenarios=10, disconnected_scenarios=5)
FULL = Budget(500, 1000, 200, 200, 3, 50, 200, narrow_scenarios=100, disconnected_scenarios=100)
BUDGETS = {"quick": QUICK, "full": FULL}


@dataclass(frozen=True, slots=True)
class Unit:
    """A run of neighbouring scenarios or problems.

    Args:
        kind: what is measured.
        split: of the scenarios.
        first: first index within the split or family.
        count: how many.
        family: of the problems; None for scenarios as they are drawn for training.
    """

    kind: Kind
    split: Split
    first: int
    count: int
    family: str | None = None


def units(
    budget: Budget,
    families: Families,
    *,
    paths: bool = False,
    there: Callable[[Split], int | None] = lambda split: None,  # noqa: ARG005
) -> list[Unit]:
    """All units of an evaluation, the long ones first, so that workers end together.

    Path models are judged by planning alone. Of scenes that were given, no more are taken than ``there`` are.
    """

    def at_most(count: int, split: Split) -> int:
        known = there(split)
        return count if known is None else min(count, known)

    problems = {Split.VALIDATION: budget.validation_problems, Split.TEST: budget.test_problems}
    work: list[Unit] = []
    for family in planned(families):
        for split in JUDGED:
            work += [Unit(Kind.PLANNING, split, *part, family) for part in _parts(problems[split], 5)]
    if paths:
        return work
    for family in families.unsolvable:
        for split in JUDGED:
            parts = _parts(budget.disconnected_scenarios, 5)
            work += [Unit(Kind.RECONSTRUCTION, split, *part, family) for part in parts]
    work += [
        Unit(Kind.TOPOLOGY, Split.TEST, *part)
        for part in _parts(at_most(budget.topology_scenarios, Split.TEST), 1)
    ]
    for split in JUDGED:
        work += [
            Unit(Kind.RECONSTRUCTION, split, *part) for part in _parts(at_most(budget.scenarios, split), 15)
        ]
    return work


def deciding(work: Iterable[Unit]) -> list[Unit]:
    """The units that decide: those that a rival is measured by as well."""
    return [
        unit
        for unit in work
        if unit.split is Split.VALIDATION and (unit.kind is Kind.PLANNING or unit.family is None)
    ]


def planned(families: Families) -> tuple[str, ...]:
    """The families that a planner is asked to solve, the one that tells most first."""
    return tuple(dict.fromkeys((families.telling, *families.solvable)))


def _parts(count: int, size: int) -> Iterator[tuple[int, int]]:
    for first in range(0, count, size):
        yield first, min(size, count - first)
