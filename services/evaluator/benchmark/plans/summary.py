"""What becomes of plans without exact checks, and how many exact checks learned paths save."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cspace.planning.scoring import calibration_error
from cspace.worlds.unseen import Taken
from services.evaluator.benchmark.plans.setting import BASE, NO_PROBLEM, PlanRun, Table, in_order
from services.evaluator.benchmark.summary import BreakEven, Spent, break_even
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    bootstrap_interval,
    censored_as_largest,
    clopper_pearson,
    difference_interval,
    ratio_of_sums_interval,
    summarise_censored,
)

Floats = NDArray[np.float64]
DEEP_M = 0.01
# Bins of the share of the arm that is unseen along a way; most have nearly all of it there.
UNSEEN_EDGES = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)
_QUANTILES = (0.5, 0.95)


def hits(run: PlanRun, deep_m: float = 0.0) -> bool:
    """Whether a way collides by spheres, so deeply."""
    return run.clearance_m is not None and run.clearance_m <= -deep_m


def hits_meshes(run: PlanRun) -> bool:
    """Whether it collides by meshes."""
    return run.meshes_free is False


@dataclass(frozen=True, slots=True)
class ArmPlans:
    """One arm, shares with exact limits.

    Args:
        arm: its name.
        solved: share of the problems.
        refused: share of the problems without a way though there was time.
        collide: share of the ways; None without ways.
        deep: share of them deeper than 1 cm.
        meshes: share of those that were looked at by meshes; None where none was.
        more: of the problems that both solve, by how much larger the share that collides is than with unseen
            space free; None for that arm itself, or where none is solved by both.
        search_ms: median and 95th percentile.
        score_ms: likewise, of asking the model.
    """

    arm: str
    solved: Interval
    refused: Interval
    collide: Interval | None
    deep: Interval | None
    meshes: Interval | None
    more: Interval | None
    search_ms: tuple[float, float]
    score_ms: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Sureness:
    """What a model's confidence in its ways is worth.

    Args:
        share: (n,) of the problems that are answered if only so many of the surest ways are taken.
        collide: (n,) share of these that collide.
        least: (n,) the least confidence among them.
        calibration_error: of the confidence, ten bins.
        surer_half: share of the surer half that collides.
        model: its name.
    """

    share: Floats
    collide: Floats
    least: Floats
    calibration_error: float
    surer_half: Interval
    model: str


class Plans:
    """Runs of one source of problems, seen by as many pictures, all arms on the same problems.

    Args:
        runs: of the benchmark.
        source: of the problems.
        pictures: by which they are seen.
    """

    def __init__(self, runs: Sequence[PlanRun], source: str, pictures: int) -> None:
        mine = [
            run
            for run in runs
            if run.table == Table.UNCHECKED and run.source == source and run.pictures in (0, pictures)
        ]
        by_arm: dict[str, dict[tuple[str, int], PlanRun]] = {}
        for run in mine:
            by_arm.setdefault(run.arm, {})[run.family, run.problem] = run
        shared = set.intersection(*(set(one) for one in by_arm.values())) if by_arm else set()
        kept = sorted(key for key in shared if all(one[key].status != NO_PROBLEM for one in by_arm.values()))
        self.source, self.pictures, self.left_out = source, pictures, len(shared) - len(kept)
        self.arms = {arm: [by_arm[arm][key] for key in kept] for arm in in_order(by_arm)}
        self.models = [arm for arm, own in self.arms.items() if own and own[0].sampler is not None]

    @property
    def count(self) -> int:
        """Of the problems."""
        return len(next(iter(self.arms.values()), ()))

    def summaries(self, rng: np.random.Generator) -> list[ArmPlans]:
        """Of every arm."""
        return [self._arm(arm, own, rng) for arm, own in self.arms.items()] if self.count else []

    def by_family(self) -> dict[str, dict[str, Interval | None]]:
        """By family and arm the share of the ways that collide."""
        families = dict.fromkeys(run.family for own in self.arms.values() for run in own)
        return {family: self._collide(partial(_is_of, family)) for family in families}

    def by_unseen(self) -> dict[tuple[float, float], dict[str, Interval | None]]:
        """By share of the arm that pictures do not show along the way, and by arm, the same."""
        found = {}
        for low, high in pairwise(UNSEEN_EDGES):
            # The last one holds its upper end.
            top = np.inf if high == UNSEEN_EDGES[-1] else high

            def within(run: PlanRun, low: float = low, top: float = top) -> bool:
                return run.unseen is not None and low <= run.unseen < top

            shares = self._collide(within)
            if any(one is not None for one in shares.values()):
                found[low, high] = shares
        return found

    def sureness(self, model: str) -> Sureness | None:
        """Of one model; None where it found no way."""
        found = [run for run in self.arms[model] if run.confidence is not None]
        if not found:
            return None
        sure = np.array([run.confidence for run in found], dtype=np.float64)
        hit = np.array([hits(run) for run in found])
        order = np.argsort(-sure, kind="stable")
        taken = np.arange(1, len(order) + 1)
        half = order[: max(1, len(order) // 2)]
        return Sureness(
            taken / self.count,
            np.cumsum(hit[order]) / taken,
            sure[order],
            calibration_error(sure, ~hit),
            clopper_pearson(int(hit[half].sum()), len(half)),
            model,
        )

    def _collide(self, wanted: Callable[[PlanRun], bool]) -> dict[str, Interval | None]:
        return {
            arm: _share([run for run in own if run.solved and wanted(run)], hits)
            for arm, own in self.arms.items()
        }

    def _arm(self, arm: str, own: Sequence[PlanRun], rng: np.random.Generator) -> ArmPlans:
        ways = [run for run in own if run.solved]
        solved = clopper_pearson(len(ways), len(own))
        refused = clopper_pearson(sum(run.status == "refused" for run in own), len(own))
        return ArmPlans(
            arm,
            solved,
            refused,
            _share(ways, hits),
            _share(ways, lambda run: hits(run, DEEP_M)),
            _share([run for run in ways if run.meshes_free is not None], hits_meshes),
            self._more(arm, own, rng),
            _times(own, "search_s"),
            _times(own, "score_s"),
        )

    def _more(self, arm: str, own: Sequence[PlanRun], rng: np.random.Generator) -> Interval | None:
        pairs = zip(own, self.arms.get(Taken.FREE.value, ()), strict=False)
        both = [(hits(one), hits(free)) for one, free in pairs if one.solved and free.solved]
        if arm == Taken.FREE.value or not both:
            return None
        mine, theirs = zip(*both, strict=True)
        return difference_interval(mine, theirs, rng)


def _is_of(family: str, run: PlanRun) -> bool:
    return run.family == family


def _share(runs: Sequence[PlanRun], wanted: Callable[[PlanRun], bool]) -> Interval | None:
    return clopper_pearson(sum(wanted(run) for run in runs), len(runs)) if runs else None


def _times(runs: Sequence[PlanRun], column: str) -> tuple[float, float]:
    low, high = np.quantile([1e3 * getattr(run, column) for run in runs], _QUANTILES)
    return float(low), float(high)


def gather_plans(runs: Sequence[PlanRun], pictures: Sequence[int]) -> list[Plans]:
    """Of every source and number of pictures, without those that have no problems."""
    sources: Mapping[str, None] = dict.fromkeys(run.source for run in runs)
    found = [Plans(runs, source, seen_by) for source in sources for seen_by in pictures]
    return [one for one in found if one.count]


COUNTS = ("state_checks", "edge_checks", "iterations")
QUANTILES = (0.5, 0.9)
ALL, HARD = "all", "the hard ones"


@dataclass(frozen=True, slots=True)
class ArmChecks:
    """One arm on a group of problems; of each problem the median over its runs counts.

    Args:
        arm: its name.
        as_is: share of runs in which one of the ways was free as it was; None for an arm without ways.
        solved: share of runs.
        counts: states, edges and iterations, by :data:`COUNTS`.
        ratios: of states to those of uniform samples, at median and 90th percentile; None for these.
        request_ms: median of what it takes to have the ways.
        solve_ms: median of the search with checks.
        length: of the paths, over uniform samples' where both are solved; None for these, or without such.
        spheres_ms: median of all time where a look at a state costs what it does by spheres.
        meshes_ms: the same by meshes; None where these are not installed.
        worth: from which cost of a look at a state on it saves time over uniform samples; None for these.
    """

    arm: str
    as_is: float | None
    solved: float
    counts: dict[str, CensoredSummary]
    ratios: tuple[Interval, Interval] | None
    request_ms: float
    solve_ms: float
    length: Interval | None
    spheres_ms: float
    meshes_ms: float | None
    worth: BreakEven | None


class Checked:
    """Runs of a group of problems, seen by as many pictures, all arms on the same problems as often.

    Args:
        name: of the group.
        runs: of the group's problems, whatever table and pictures they are of.
        pictures: by which they are seen.
    """

    def __init__(self, name: str, runs: Sequence[PlanRun], pictures: int) -> None:
        mine = [
            run
            for run in runs
            if run.table == Table.CHECKED and run.status != NO_PROBLEM and run.pictures in (0, pictures)
        ]
        by_arm: dict[str, dict[tuple[str, int, int], PlanRun]] = {}
        for run in mine:
            by_arm.setdefault(run.arm, {})[run.family, run.problem, run.run] = run
        shared = sorted(set.intersection(*(set(one) for one in by_arm.values()))) if by_arm else []
        problems: dict[tuple[str, int], list[tuple[str, int, int]]] = {}
        for key in shared:
            problems.setdefault(key[:2], []).append(key)
        # Problems of which fewer runs were made than of others wait for the rest.
        most = max(map(len, problems.values()), default=0)
        kept = [keys for keys in problems.values() if len(keys) == most]
        self.name, self.pictures, self.runs_each = name, pictures, most
        self.arms = {
            arm: [[one[key] for key in keys] for keys in kept]
            for arm, one in ((name, by_arm[name]) for name in in_order(by_arm))
        }

    @property
    def count(self) -> int:
        """Of the problems."""
        return len(next(iter(self.arms.values()), ()))

    def summaries(self, rng: np.random.Generator) -> list[ArmChecks]:
        """Of every arm; none where uniform samples are missing."""
        if not self.count or BASE.name not in self.arms:
            return []
        return [self._arm(arm, rng) for arm in self.arms]

    def values(self, arm: str, column: str) -> Floats:
        """(P, R) of a column; nan where a run has none."""
        rows = [[getattr(run, column) for run in runs] for runs in self.arms[arm]]
        return np.array(rows, dtype=np.float64)

    def _arm(self, arm: str, rng: np.random.Generator) -> ArmChecks:
        is_base, solved = arm == BASE.name, self.values(arm, "solved")
        cut = np.median(solved, axis=1) < 1.0
        counts = {name: summarise_censored(np.median(self.values(arm, name), axis=1), cut) for name in COUNTS}
        whole_s, spheres_s, meshes_s = self._whole_s(arm)
        return ArmChecks(
            arm,
            None if is_base else float(self.values(arm, "as_is").mean()),
            float(solved.mean()),
            counts,
            None if is_base else self._ratios(arm, rng),
            1e3 * float(np.median(self.values(arm, "request_s"))),
            1e3 * float(np.median(self.values(arm, "solve_s"))),
            None if is_base else self._length(arm, rng),
            1e3 * float(np.median(spheres_s)),
            None if meshes_s is None else 1e3 * float(np.median(meshes_s)),
            None if is_base else break_even(whole_s, [self._whole_s(BASE.name)[0]], rng),
        )

    def _whole_s(self, arm: str) -> tuple[Spent, Floats, Floats | None]:
        """What an arm takes without its checks, and all by the prices of spheres and of meshes."""
        # One price for all arms on a problem.
        checks, price_s = self.values(arm, "state_checks"), self.values(BASE.name, "state_check_s")
        own_s = np.maximum(self.values(arm, "solve_s") - checks * price_s, 0.0)
        fixed_s = self.values(arm, "request_s") + own_s
        meshes_s = self.values(BASE.name, "mesh_check_s")
        told = None if np.isnan(meshes_s).any() else np.median(fixed_s + checks * meshes_s, axis=1)
        spent = Spent(fixed_s.sum(axis=1), checks.sum(axis=1))
        return spent, np.median(fixed_s + checks * price_s, axis=1), told

    def _ratios(self, arm: str, rng: np.random.Generator) -> tuple[Interval, Interval]:
        pairs = []
        for one in (arm, BASE.name):
            cut = np.median(self.values(one, "solved"), axis=1) < 1.0
            pairs.append(censored_as_largest(np.median(self.values(one, "state_checks"), axis=1), cut))
        table = np.stack(pairs, axis=1)
        middle, high = (bootstrap_interval(table, partial(_ratio, share), rng) for share in QUANTILES)
        return middle, high

    def _length(self, arm: str, rng: np.random.Generator) -> Interval | None:
        mine, base = (np.median(self.values(one, "length_rad"), axis=1) for one in (arm, BASE.name))
        both = ~(np.isnan(mine) | np.isnan(base))
        return ratio_of_sums_interval(mine[both], base[both], rng) if both.any() else None


def gather_checked(runs: Sequence[PlanRun], pictures: Sequence[int], hard: Sequence[str]) -> list[Checked]:
    """By pictures: all of a source together, the hard ones, and every family."""
    groups: dict[str, list[PlanRun]] = {}
    for source in dict.fromkeys(run.source for run in runs):
        own = [run for run in runs if run.source == source]
        groups[f"{source}, {ALL}"] = own
        if chosen := [run for run in own if run.family in hard]:
            groups[f"{source}, {HARD}"] = chosen
    for run in runs:
        groups.setdefault(run.family, []).append(run)
    found = [Checked(name, own, seen_by) for seen_by in pictures for name, own in groups.items()]
    return [one for one in found if one.count]


def _ratio(share: float, pairs: Floats) -> Floats:
    """Of the columns' quantiles, (..., n, 2) to (...)."""
    first, second = np.moveaxis(np.quantile(pairs, share, axis=-2, method="higher"), -1, 0)
    return np.asarray(first / second)
