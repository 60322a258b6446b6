"""The arms of the benchmark (every way in which a problem is solved) and the limits of its runs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import product

from cspace.errors import ConfigError
from cspace.query import SampleQuery
from cspace.splits import Split
from cspace.workshop import Families
from cspace.world import World
from cspace.worlds import default_world, workshop_of
from services.evaluator.evaluation.units import planner_seed
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

# Of the world's range, at which uniform RRT is measured as well, so that its own best one is known.
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


class Group(StrEnum):
    """What an arm is there for."""

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
    """One way to solve a problem.

    Args:
        name: unique.
        group: what it is there for.
        planner: by its name in :mod:`services.planner.settings`.
        base: name of the arm that it is compared with: the same planner with uniform samples.
        sampler: name of the learned sampler; None for uniform samples.
        learned_share: of learned samples among the drawn ones while there are any, 0 to 1.
        samples: how many learned samples are asked for.
        epsilon_sigma: what the encoder's standard deviation is raised by, in equal shares.
        in_order: whether the samples of several values are drawn one value after the other, as algorithm 3 of
            the paper has it, instead of mixed.
        ordered: whether the planner takes the samples along the way through them, from the start on.
        min_confidence: what the sampler's validity head has to score; 0 for the samples as they come.
        colliding_last: whether the planner takes samples that collide after all others.
        range_rad: of the planner, in OMPL's metric; one rad until :func:`table` knows the world's.
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
        """What is asked of the learned sampler for the run of a seed, start and goal apart."""
        return SampleQuery(self.samples, seed, self.epsilon_sigma, min_confidence=self.min_confidence)


@dataclass(frozen=True, slots=True)
class Taken:
    """How arms take learned samples where their group leaves it open.

    Args:
        min_confidence: of the filtered and the ordered arms.
        samples: how many an arm asks for that does not say so in its name.
        shares: of learned samples among the drawn ones, 0 to 1 each; of every one there is an arm.
    """

    min_confidence: float = MIN_CONFIDENCE
    samples: int = SAMPLES
    shares: tuple[float, ...] = LEARNED_SHARES


_AS_USUAL = Taken()


def table(samplers: Sequence[str], range_rad: float, taken: Taken = _AS_USUAL) -> tuple[Arm, ...]:
    """All arms that there are.

    Args:
        samplers: names of the learned samplers.
        range_rad: that planners have in this world.
        taken: how the arms take their samples.
    """
    arms = [*_uniform_arms(range_rad), *_optimising_arms(None, taken)]
    for sampler in samplers:
        arms += [*_learned_arms(sampler, taken), *_filtered_arms(sampler, taken)]
        arms += [*_ordered_arms(sampler, taken), *_checked_arms(sampler, taken)]
        arms += [*_schedule_arms(sampler, taken.samples)]
        arms += [*_optimising_arms(sampler, taken), *_count_arms(sampler)]
    return tuple(replace(arm, range_rad=range_rad * arm.range_rad) for arm in arms)


def pick(arms: Sequence[Arm], wanted: Sequence[str], planners: Sequence[str] = ()) -> tuple[Arm, ...]:
    """The arms of some names or groups, with the bases that they need.

    Args:
        arms: to choose from.
        wanted: names of arms or groups.
        planners: only arms of these planners; empty for all.

    Raises:
        ConfigError: a name is no arm's and no group's, a planner is none, or nothing is left.
    """
    known = {arm.name for arm in arms} | {group.value for group in Group}
    for name in wanted:
        if name not in known:
            raise ConfigError("there is no such arm or group", expected=", ".join(Group), got=repr(name))
    for planner in planners:
        if planner not in PLANNERS:
            raise ConfigError("the planner is unknown", expected=" or ".join(PLANNERS), got=repr(planner))
    chosen = {
        arm.name
        for arm in arms
        if {arm.name, arm.group.value} & set(wanted) and (not planners or arm.planner in planners)
    }
    chosen |= {arm.base for arm in arms if arm.name in chosen}
    if not chosen:
        raise ConfigError("no arm is left", got=f"arms {list(wanted)}, planners {list(planners)}")
    return tuple(arm for arm in arms if arm.name in chosen)


def _label(planner: str) -> str:
    return NAMES.get(planner, planner)


def _uniform(planner: str) -> str:
    return f"{_label(planner)}, uniform"


def _percent(share: float) -> str:
    return f"{100.0 * share:g} %"


def _uniform_arms(range_rad: float) -> Iterator[Arm]:
    for planner in _UNIFORM:
        yield Arm(_uniform(planner), Group.UNIFORM, planner, _uniform(planner))
    for factor in OTHER_RANGES:
        name = f"{_uniform(RRT)}, range {factor * range_rad:g}"
        yield Arm(name, Group.UNIFORM, RRT, _uniform(RRT), range_rad=factor)


def _learned_arms(sampler: str, taken: Taken) -> Iterator[Arm]:
    for planner in LEARNED_PLANNERS:
        for share in taken.shares:
            yield _with(sampler, planner, Group.LEARNED, share, _percent(share), taken.samples)


def _filtered_arms(sampler: str, taken: Taken) -> Iterator[Arm]:
    """None where the confidence drops nothing: they would be the learned arms under another name."""
    least = taken.min_confidence
    for share in taken.shares if least > 0.0 else ():
        name = f"{_percent(share)}, filtered"
        arm = _with(sampler, RRT, Group.FILTERED, share, name, taken.samples)
        yield replace(arm, min_confidence=least)


def _ordered_arms(sampler: str, taken: Taken) -> Iterator[Arm]:
    """Samples that the planner takes along the way through them, filtered where a confidence is asked for."""
    for planner in (RRT, SAMPLED_CONNECT):
        for share in taken.shares:
            name = f"{_percent(share)}, ordered"
            arm = _with(sampler, planner, Group.ORDERED, share, name, taken.samples)
            yield replace(arm, min_confidence=taken.min_confidence, ordered=True)


def _checked_arms(sampler: str, taken: Taken) -> Iterator[Arm]:
    """Samples of which the planner takes those that collide last, as they come and along the way."""
    for planner in (RRT, SAMPLED_CONNECT):
        for share in taken.shares:
            name = f"{_percent(share)}, colliding last"
            arm = _with(sampler, planner, Group.CHECKED, share, name, taken.samples)
            yield replace(arm, colliding_last=True)
            name = f"{_label(planner)}, {sampler}, {_percent(share)}, ordered, colliding last"
            yield replace(arm, name=name, ordered=True, colliding_last=True)


def _schedule_arms(sampler: str, samples: int) -> Iterator[Arm]:
    """Perturbed samples, mixed and in the paper's order, against uniform ones beside as many unperturbed."""
    perturbed = _with(sampler, RRT, Group.SCHEDULE, 1.0, "schedule", samples)
    perturbed = replace(perturbed, epsilon_sigma=PAPER_SCHEDULE)
    yield perturbed
    yield replace(perturbed, name=f"{perturbed.name} in order", in_order=True)
    least = 1.0 / len(PAPER_SCHEDULE)
    few = round(samples * least)
    yield _with(sampler, RRT, Group.SCHEDULE, least, f"{_percent(least)}, {few} samples", few)


def _optimising_arms(sampler: str | None, taken: Taken) -> Iterator[Arm]:
    base = f"{_label(RRT_STAR)}, uniform, optimising"
    if sampler is None:
        for planner in OPTIMISING_PLANNERS:
            name = f"{_uniform(planner)}, optimising"
            yield Arm(name, Group.OPTIMISING, planner, base, stop_at_first=False)
        return
    for share in taken.shares:
        name = f"{_percent(share)}, optimising"
        arm = _with(sampler, RRT_STAR, Group.OPTIMISING, share, name, taken.samples)
        yield replace(arm, base=base, stop_at_first=False)


def _count_arms(sampler: str) -> Iterator[Arm]:
    for count in SAMPLE_COUNTS:
        name = f"{_percent(DEFAULT_SHARE)}, {count} samples"
        yield _with(sampler, RRT, Group.COUNTS, DEFAULT_SHARE, name, count)


def _with(sampler: str, planner: str, group: Group, share: float, name: str, samples: int) -> Arm:
    whole_name = f"{_label(planner)}, {sampler}, {name}"
    return Arm(whole_name, group, planner, _uniform(planner), sampler, share, samples)


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
