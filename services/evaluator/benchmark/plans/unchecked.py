"""The first table: what becomes of ways that nobody checks exactly."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cspace.planning.scoring import calibration_error
from cspace.worlds.unseen import Taken
from services.evaluator.benchmark.plans.record import NO_PROBLEM, PlanRun
from services.evaluator.benchmark.plans.setting import Table, in_order
from services.evaluator.statistics import Interval, clopper_pearson, difference_interval

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
