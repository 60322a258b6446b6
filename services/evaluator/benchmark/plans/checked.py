"""The second table: how many exact checks ways save, and from which price of a check on they save time."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from services.evaluator.benchmark.plans.record import NO_PROBLEM, PlanRun
from services.evaluator.benchmark.plans.setting import BASE, Table, in_order
from services.evaluator.benchmark.summary.break_even import BreakEven, Spent, break_even
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    bootstrap_interval,
    censored_as_largest,
    ratio_of_sums_interval,
    summarise_censored,
)

Floats = NDArray[np.float64]
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
