"""The arms of the benchmark (each is one way to solve a problem), its settings and its units of work."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from cspace.errors import ConfigError
from cspace.query import SampleQuery
from cspace.simulator import Families, Split
from cspace.simulator import Taken as Unseen
from cspace.world import World
from cspace.worlds import default_world, simulator_of
from services.evaluator.measure import planner_seed
from services.planner.planning import PAPER_SCHEDULE
from services.planner.settings import (
    BIT_STAR,
    INFORMED_RRT_STAR,
    LEARNED_PLANNERS,
    OPTIMISING_PLANNERS,
    PLANNERS,
    PRM,
    RRT,
    RRT_CONNECT,
    RRT_STAR,
    SAMPLED_CONNECT,
    PlannerSettings,
)

# Uniform RRT also runs with these multiples of the world's range, so that its own best range is known.
OTHER_RANGES = (0.5, 2.0)
LEARNED_SHARES = (0.7, 1.0)
DEFAULT_SHARE = 0.7
SAMPLES = 300
SAMPLE_COUNTS = (10, 30, 100, 300, 1000)
MIN_CONFIDENCE = 0.5
NAMES = {
    RRT_STAR: "RRT*",
    RRT_CONNECT: "RRT-Connect",
    SAMPLED_CONNECT: "own RRT-Connect",
    INFORMED_RRT_STAR: "InformedRRT*",
    BIT_STAR: "BIT*",
}
_UNIFORM = (RRT, RRT_CONNECT, SAMPLED_CONNECT, RRT_STAR, INFORMED_RRT_STAR, BIT_STAR, PRM)


class Protocol(StrEnum):
    """What the benchmark runs.

    ``families``: many problems of every family, once each, up to a number of iterations. ``paper``: few
    problems, many times each, up to a wall time. ``plans``: paths through scenes that pictures show in part.
    """

    FAMILIES = "families"
    PAPER = "paper"
    PLANS = "plans"


class Group(StrEnum):
    """Purpose of an arm."""

    UNIFORM = "uniform"
    LEARNED = "learned"
    FILTERED = "filtered"
    SCHEDULE = "schedule"
    OPTIMISING = "optimising"
    COUNTS = "counts"
    ORDERED = "ordered"
    CHECKED = "checked"


@dataclass(frozen=True, slots=True)
class Arm:
    """One planner with one source of samples.

    Args:
        name: unique.
        group: its purpose.
        planner: by its name in :mod:`services.planner.settings`.
        base: name of the arm that it is compared with: the same planner with uniform samples.
        sampler: name of the learned sampler; None for uniform samples.
        learned_share: share of learned samples among the drawn ones while there are any, 0 to 1.
        samples: number of learned samples that are requested.
        epsilon_sigma: increments of the encoder's standard deviation, in equal shares.
        in_order: whether the samples of several increments are drawn one increment after the other, as
            algorithm 3 of the paper does, instead of mixed.
        ordered: whether the planner takes the samples along the path through them.
        min_confidence: threshold of the sampler's validity head; 0 for all samples.
        colliding_last: whether the planner takes samples that collide after all others.
        range_rad: range of the planner in OMPL's metric.
        stop_at_first: whether the search ends with its first solution.
    """

    name: str
    group: Group
    planner: str
    base: str
    sampler: str | None = None
    learned_share: float = 0.0
    samples: int = 0
    epsilon_sigma: tuple[float, ...] = (0.0,)
    in_order: bool = False
    ordered: bool = False
    min_confidence: float = 0.0
    colliding_last: bool = False
    range_rad: float = 1.0
    stop_at_first: bool = True

    def query(self, seed: int) -> SampleQuery:
        """The request to the learned sampler, without start and goal."""
        return SampleQuery(self.samples, seed, self.epsilon_sigma, min_confidence=self.min_confidence)

    @property
    def treated(self) -> bool:
        """Whether the samples are filtered, ordered or checked before the planner draws them."""
        return self.min_confidence > 0.0 or self.ordered or self.colliding_last


@dataclass(frozen=True, slots=True)
class Taken:
    """Options of the arms with learned samples.

    Args:
        min_confidence: threshold of the filtered and the ordered arms.
        samples: number that an arm requests unless its name states one.
        shares: of learned samples among the drawn ones, above 0 to 1; one arm for each.
    """

    min_confidence: float = MIN_CONFIDENCE
    samples: int = SAMPLES
    shares: tuple[float, ...] = LEARNED_SHARES


def table(samplers: Sequence[str], range_rad: float, taken: Taken | None = None) -> tuple[Arm, ...]:
    """All arms of the protocols ``families`` and ``paper``, for the names of learned samplers."""
    arms = [Arm(_uniform(planner), Group.UNIFORM, planner, _uniform(planner)) for planner in _UNIFORM]
    for factor in OTHER_RANGES:
        name = f"{_uniform(RRT)}, range {factor * range_rad:g}"
        arms.append(Arm(name, Group.UNIFORM, RRT, _uniform(RRT), range_rad=factor))
    for planner in OPTIMISING_PLANNERS:
        name = f"{_uniform(planner)}, optimising"
        arms.append(Arm(name, Group.OPTIMISING, planner, _OPTIMISING_BASE, stop_at_first=False))
    for sampler in samplers:
        arms += _learned_arms(sampler, taken or Taken())
    return tuple(replace(arm, range_rad=range_rad * arm.range_rad) for arm in arms)


def _learned_arms(sampler: str, taken: Taken) -> Iterator[Arm]:
    def arm(planner: str, group: Group, share: float, what: str = "", **changes: Any) -> Arm:
        parts = (NAMES.get(planner, planner), sampler, f"{100.0 * share:g} %", what)
        name = ", ".join(filter(None, parts))
        plain = Arm(name, group, planner, _uniform(planner), sampler, share, taken.samples)
        return replace(plain, **changes)

    least = taken.min_confidence
    last = {"colliding_last": True}
    for share in taken.shares:
        yield from (arm(planner, Group.LEARNED, share) for planner in LEARNED_PLANNERS)
        if least > 0.0:
            yield arm(RRT, Group.FILTERED, share, "filtered", min_confidence=least)
        for planner in (RRT, SAMPLED_CONNECT):
            yield arm(planner, Group.ORDERED, share, "ordered", min_confidence=least, ordered=True)
            yield arm(planner, Group.CHECKED, share, "colliding last", **last)
            yield arm(planner, Group.CHECKED, share, "ordered, colliding last", ordered=True, **last)
        yield arm(RRT_STAR, Group.OPTIMISING, share, "optimising", base=_OPTIMISING_BASE, stop_at_first=False)
    # Perturbed samples, mixed and in the paper's order, and as many unperturbed ones among uniform ones.
    perturbed = arm(RRT, Group.SCHEDULE, 1.0, name=f"RRT, {sampler}, schedule", epsilon_sigma=PAPER_SCHEDULE)
    yield perturbed
    yield replace(perturbed, name=f"{perturbed.name} in order", in_order=True)
    few = round(taken.samples / len(PAPER_SCHEDULE))
    yield arm(RRT, Group.SCHEDULE, 1.0 / len(PAPER_SCHEDULE), f"{few} samples", samples=few)
    for count in SAMPLE_COUNTS:
        yield arm(RRT, Group.COUNTS, DEFAULT_SHARE, f"{count} samples", samples=count)


def _uniform(planner: str) -> str:
    return f"{NAMES.get(planner, planner)}, uniform"


_OPTIMISING_BASE = f"{_uniform(RRT_STAR)}, optimising"


def pick(arms: Sequence[Arm], wanted: Sequence[str], planners: Sequence[str] = ()) -> tuple[Arm, ...]:
    """The arms of some names or groups, only those of some planners if any are named, and their bases.

    Raises:
        ConfigError: a name is unknown, or nothing is left.
    """
    if unknown := set(wanted) - {arm.name for arm in arms} - set(Group):
        raise ConfigError("there is no such arm or group", expected=", ".join(Group), got=", ".join(unknown))
    if unknown := set(planners) - set(PLANNERS):
        raise ConfigError("the planner is unknown", expected=" or ".join(PLANNERS), got=", ".join(unknown))
    found = [arm for arm in arms if {arm.name, arm.group} & set(wanted)]
    found = [arm for arm in found if not planners or arm.planner in planners]
    chosen = {name for arm in found for name in (arm.name, arm.base)}
    if not chosen:
        raise ConfigError("no arm is left", got=f"arms {list(wanted)}, planners {list(planners)}")
    return tuple(arm for arm in arms if arm.name in chosen)


def plain_arm(arm: Arm, arms: Sequence[Arm]) -> Arm | None:
    """The arm that takes the samples as they come and is otherwise the same; None if there is none."""

    def planning(one: Arm) -> tuple[object, ...]:
        return one.planner, one.sampler, one.learned_share, one.samples, one.epsilon_sigma, one.stop_at_first

    plain = [one for one in arms if one.group is Group.LEARNED and planning(one) == planning(arm)]
    return plain[0] if plain and arm.treated else None


@dataclass(frozen=True, slots=True)
class PlanArm:
    """One way to plan through a scene that pictures show in part.

    Args:
        name: unique.
        checked: whether a planner with exact checks goes on from the paths; False: without checks.
        sampler: name of the model that plans; None for none.
        unseen: what unseen space counts as where no model plans; None for no paths at all.
    """

    name: str
    checked: bool
    sampler: str | None = None
    unseen: Unseen | None = None

    @property
    def pictured(self) -> bool:
        """Whether the result depends on the pictures."""
        return self.sampler is not None or self.unseen not in (None, Unseen.KNOWN)


CONNECT = PlanArm("RRT-Connect, uniform", checked=True)
TRUE_PATHS = PlanArm("RRT-Connect, paths of the truth", checked=True, unseen=Unseen.KNOWN)


def plan_arms(models: Sequence[str]) -> tuple[PlanArm, ...]:
    """All arms of the protocol ``plans``, in the order of the report."""
    return (
        *(PlanArm(name, checked=False, sampler=name) for name in models),
        *(PlanArm(unseen.value, checked=False, unseen=unseen) for unseen in Unseen),
        CONNECT,
        *(PlanArm(f"RRT-Connect, paths of {name}", checked=True, sampler=name) for name in models),
        TRUE_PATHS,
    )


# Seconds in which a model or a search without exact checks looks for paths.
PLAN_LIMIT_S = 2.0
LIMITS: Mapping[Protocol, Mapping[str, float]] = {
    Protocol.FAMILIES: {"max_iterations": 20_000, "optimising_iterations": 2000, "time_limit_s": 10.0},
    # The paper stops by the clock alone; no planner here makes so many iterations in a second.
    Protocol.PAPER: {"max_iterations": 200_000, "optimising_iterations": 200_000, "time_limit_s": 1.0},
    Protocol.PLANS: {"max_iterations": 200_000, "optimising_iterations": 2000, "time_limit_s": 20.0},
}
RUNS = {Protocol.FAMILIES: 1, Protocol.PAPER: 100, Protocol.PLANS: 3}
PICTURES = (1, 2, 3)
AIMS = ("goal", "scene")


@dataclass(frozen=True, slots=True)
class Setting:
    """What all runs of a folder have in common.

    Args:
        protocol: what is run.
        split: of the problems.
        seed: of problems, planners and samplers.
        max_iterations: states drawn after which a search ends without a path.
        optimising_iterations: the same for a search that goes on after its first solution.
        time_limit_s: wall time after which a search ends.
        aim: what cameras look at, ``goal`` or ``scene``.
        plan_limit_s: time in which paths are planned without exact checks.
        world: robot and sensor.
        held: whether the robot holds what goals grasp, and planners know this and the table.
    """

    protocol: Protocol
    split: Split
    seed: int
    max_iterations: int
    optimising_iterations: int
    time_limit_s: float
    aim: str = AIMS[0]
    plan_limit_s: float = PLAN_LIMIT_S
    world: World = field(default_factory=default_world)
    held: bool = False

    @property
    def families(self) -> Families:
        """Of the world's problems."""
        return simulator_of(self.world).families

    @property
    def resolution_rad(self) -> float:
        """Largest distance between checked states of an edge in any joint."""
        return simulator_of(self.world).measures.resolution_rad

    @property
    def range_rad(self) -> float:
        """Range of the planners in this world, in OMPL's metric."""
        return simulator_of(self.world).measures.range_rad

    def planner(self, arm: Arm | None, index: int, run: int) -> PlannerSettings:
        """The settings of one run; the seed is the same for every arm, None stands for plain RRT-Connect."""
        stop_at_first = arm is None or arm.stop_at_first
        return PlannerSettings(
            planner=SAMPLED_CONNECT if arm is None else arm.planner,
            range_rad=self.range_rad if arm is None else arm.range_rad,
            resolution_rad=self.resolution_rad,
            time_limit_s=self.time_limit_s,
            max_iterations=self.max_iterations if stop_at_first else self.optimising_iterations,
            seed=planner_seed(self.seed, index, run),
            stop_at_first=stop_at_first,
            colliding_last=arm is not None and arm.colliding_last,
        )


Key = tuple[str, int, int, int, str]


@dataclass(frozen=True, slots=True)
class Unit:
    """One problem with the runs that one process does at a time.

    Args:
        family: of the problem.
        index: of the problem within its family.
        todo: arms and the numbers of their runs.
        pictures: by which the scene is seen; 0 where the runs do not depend on them.
        folder: of problems that do not ship.
    """

    family: str
    index: int
    todo: tuple[tuple[Any, int], ...]
    pictures: int = 0
    folder: Path | None = None

    def run_keys(self) -> list[Key]:
        """Family, problem, pictures, run and arm of every run."""
        return [(self.family, self.index, self.pictures, run, arm.name) for arm, run in self.todo]

    def without(self, done: set[Key]) -> "Unit":
        """The unit with the runs that are still missing."""
        todo = zip(self.run_keys(), self.todo, strict=True)
        return replace(self, todo=tuple(one for key, one in todo if key not in done))
