"""What the benchmark compares: variants (planner and source of samples), settings, and units of work."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

from cspace.errors import ConfigError
from cspace.simulator import Families, Problem, ProblemRequest, Split, UnseenPolicy
from cspace.world import World
from cspace.worlds import default_world, partly_seen, simulator_of
from services.evaluator.evaluation import planner_seed
from services.planner.result import (
    LEARNED_PLANNERS,
    PLANNERS,
    RRT,
    RRT_CONNECT,
    RRT_STAR,
    SAMPLED_CONNECT,
    PlannerSettings,
)

SAMPLES = 300
SHARES = (0.7, 1.0)
PICTURES = (1, 2, 3)
# Status of a problem whose start or goal collides; it is left out.
NO_PROBLEM = "start or goal collides"
NAMES = {RRT: "RRT", RRT_STAR: "RRT*", RRT_CONNECT: "RRT-Connect", SAMPLED_CONNECT: "own RRT-Connect"}


class Protocol(StrEnum):
    """A preset: many problems once each, the paper's few problems often, or plans from depth pictures."""

    FAMILIES = "families"
    PAPER = "paper"
    PLANS = "plans"


class Group(StrEnum):
    """Purpose of a variant."""

    UNIFORM = "uniform"
    LEARNED = "learned"
    PLANS = "plans"


GROUPS: Mapping[Protocol, tuple[Group, ...]] = {
    Protocol.FAMILIES: (Group.UNIFORM, Group.LEARNED),
    Protocol.PAPER: (Group.UNIFORM, Group.LEARNED),
    Protocol.PLANS: (Group.PLANS,),
}
RUNS = {Protocol.FAMILIES: 1, Protocol.PAPER: 100, Protocol.PLANS: 1}
# Iterations and seconds after which a search ends.
LIMITS: Mapping[Protocol, tuple[int, float]] = {
    Protocol.FAMILIES: (20_000, 10.0),
    # The paper stops by the clock alone; no planner here makes so many iterations in a second.
    Protocol.PAPER: (200_000, 1.0),
    Protocol.PLANS: (200_000, 2.0),
}


@dataclass(frozen=True, slots=True)
class Variant:
    """One way to solve a problem; ``base`` names the variant that it is compared with.

    Without a ``planner`` it plans without exact checks. ``share`` is that of learned samples among the drawn
    ones while there are any. ``unseen`` is what unseen space counts as where no model plans.
    """

    name: str
    group: Group
    planner: str | None
    base: str | None = None
    sampler: str | None = None
    share: float = 0.0
    samples: int = 0
    unseen: UnseenPolicy | None = None

    @property
    def pictured(self) -> bool:
        """Whether the result depends on the depth pictures."""
        return self.sampler is not None or self.unseen not in (None, UnseenPolicy.KNOWN)


def table(
    protocol: Protocol, models: Sequence[str], samples: int = SAMPLES, shares: Sequence[float] = SHARES
) -> tuple[Variant, ...]:
    """All variants of a protocol for the names of models, in the order of the report."""
    return tuple(_plans(models) if protocol is Protocol.PLANS else _samples(models, samples, shares))


def _samples(models: Sequence[str], samples: int, shares: Sequence[float]) -> Iterator[Variant]:
    def uniform(planner: str) -> str:
        return f"{NAMES[planner]}, uniform"

    for planner in PLANNERS:
        yield Variant(uniform(planner), Group.UNIFORM, planner, uniform(planner))
    for model in models:
        for share in shares:
            for planner in LEARNED_PLANNERS:
                name = f"{NAMES[planner]}, {model}, {100.0 * share:g} %"
                yield Variant(name, Group.LEARNED, planner, uniform(planner), model, share, samples)


def _plans(models: Sequence[str]) -> Iterator[Variant]:
    free = UnseenPolicy.FREE.value
    yield from (Variant(model, Group.PLANS, None, free, model) for model in models)
    yield from (Variant(unseen.value, Group.PLANS, None, free, unseen=unseen) for unseen in UnseenPolicy)


def pick(variants: Sequence[Variant], wanted: Sequence[str]) -> tuple[Variant, ...]:
    """The variants of some names or groups, and their bases."""
    if unknown := set(wanted) - {variant.name for variant in variants} - set(Group):
        raise ConfigError(
            "there is no such variant or group", expected=", ".join(Group), got=", ".join(unknown)
        )
    found = [variant for variant in variants if {variant.name, variant.group} & set(wanted)]
    chosen = {name for variant in found for name in (variant.name, variant.base)}
    return tuple(variant for variant in variants if variant.name in chosen)


@dataclass(frozen=True, slots=True)
class Setting:
    """What all runs of a folder have in common."""

    protocol: Protocol
    split: Split
    seed: int
    max_iterations: int
    time_limit_s: float
    world: World = field(default_factory=default_world)

    @property
    def families(self) -> Families:
        """Of the world's problems."""
        return simulator_of(self.world).families

    def problem(self, unit: "Unit") -> Problem | None:
        """A unit's problem; None where an end of it collides."""
        if self.protocol is not Protocol.PLANS:
            return simulator_of(self.world).problem(unit.family, self.split, self.seed, unit.index)
        request = ProblemRequest(self.split, self.seed, folder=unit.folder)
        found: Problem | None = partly_seen(self.world).problem(
            request, unit.family, unit.index, max(1, unit.pictures)
        )
        return found

    def planner(self, variant: Variant, index: int, run: int) -> PlannerSettings:
        """The settings of one run; the seed is the same for every variant."""
        measures = simulator_of(self.world).measures
        return PlannerSettings(
            planner=variant.planner or SAMPLED_CONNECT,
            range_rad=measures.range_rad,
            resolution_rad=measures.resolution_rad,
            time_limit_s=self.time_limit_s,
            max_iterations=self.max_iterations,
            seed=planner_seed(self.seed, index, run),
        )


# Family, problem, pictures, run and variant.
Key = tuple[str, int, int, int, str]


@dataclass(frozen=True, slots=True)
class Unit:
    """One problem with the runs that one process does at a time; ``pictures`` is 0 where none matter."""

    family: str
    index: int
    todo: tuple[tuple[Variant, int], ...]
    pictures: int = 0
    folder: Path | None = None

    def run_keys(self) -> list[Key]:
        """The key of every run."""
        return [(self.family, self.index, self.pictures, run, variant.name) for variant, run in self.todo]

    def without(self, done: set[Key]) -> "Unit":
        """The unit with the runs that are still missing."""
        todo = zip(self.run_keys(), self.todo, strict=True)
        return replace(self, todo=tuple(one for key, one in todo if key not in done))
