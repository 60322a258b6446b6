"""What the runs of one family say of each arm: quantiles with censored runs, ratios with intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.evaluator.benchmark.arms import Arm, Group
from services.evaluator.benchmark.break_even import BreakEven, Spent, break_even
from services.evaluator.benchmark.paired import Floats, PairedRuns
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    bootstrap_interval,
    censored_as_largest,
    clopper_pearson,
    ratio_of_sums_interval,
    summarise_censored,
)
from services.planner.settings import RRT_CONNECT, SAMPLED_CONNECT

Flags = NDArray[np.bool_]
WITHIN = 1000
QUANTILES = (0.5, 0.9)
RESAMPLES = 2000
# Two programs of one algorithm.
_SAME = {SAMPLED_CONNECT: RRT_CONNECT}


@dataclass(frozen=True, slots=True)
class Ratios:
    """Median and 90th percentile over those of another arm."""

    median: Interval
    p90: Interval


@dataclass(frozen=True, slots=True)
class ArmSummary:
    """One arm on one family.

    Args:
        arm: what was run.
        solved: share that was solved at all.
        within: share that was solved within ``WITHIN`` iterations.
        iterations: quantiles; runs without success rank last.
        edge_checks: likewise.
        iteration_ratios: to the base; None for a base.
        check_ratios: likewise.
        own_best: name of the best uniform arm of the same planner, over ranges and programs.
        own_best_ratios: iterations to that of ``own_best``; None where it is the base.
        length_ratio: first solutions' lengths over the base's, where both succeeded; None where none did.
        length_rad: mean length of the paths found, None where there are none.
        request_ms: median and 90th percentile.
        solve_ms: likewise, of the search; runs without success rank last.
        total_ms: likewise, of both.
        break_even_base: over the base; None for uniform arms.
        break_even_best: over all uniform arms; None for uniform arms.
    """

    arm: Arm
    solved: Interval
    within: Interval
    iterations: CensoredSummary
    edge_checks: CensoredSummary
    iteration_ratios: Ratios | None
    check_ratios: Ratios | None
    own_best: str
    own_best_ratios: Ratios | None
    length_ratio: Interval | None
    length_rad: float | None
    request_ms: tuple[float, float]
    solve_ms: CensoredSummary
    total_ms: CensoredSummary
    break_even_base: BreakEven | None
    break_even_best: BreakEven | None


def summarise(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> list[ArmSummary]:
    """All arms that end with their first solution, in the order given.

    Args:
        runs: of one family.
        arms: that were run; those that optimise are for :mod:`services.evaluator.benchmark.convergence`.
        rng: source of the resampling.

    Raises:
        EvaluationError: an arm has no runs.
    """
    present = [arm for arm in arms if arm.stop_at_first and arm.name in runs.arms]
    uniform = [arm for arm in present if arm.group is Group.UNIFORM]
    return [_arm(runs, arm, uniform, rng) for arm in present]


def spent(runs: PairedRuns, arm: str) -> Spent:
    """What an arm took apart from its checks, and how many those were, by problem."""
    request_s, solve_s = runs.values(arm, "request_s"), runs.values(arm, "solve_s")
    fixed_s = request_s + solve_s - runs.values(arm, "check_s")
    return Spent(fixed_s.sum(axis=1), runs.values(arm, "edge_checks").sum(axis=1))


def ratios(
    values: Floats, failed: Flags, base: Floats, base_failed: Flags, rng: np.random.Generator
) -> Ratios:
    """Quantiles over those of a base, over all runs; the interval is over problems.

    Args:
        values: (P, R) of the arm.
        failed: (P, R) whether a run was cut off; it ranks behind all runs of both.
        base: (P, R) of the base, on the same problems.
        base_failed: likewise.
        rng: source of the resampling.
    """
    both = np.stack([values, base], axis=-1)
    cut = np.stack([failed, base_failed], axis=-1)
    ranked = censored_as_largest(both.ravel(), cut.ravel()).reshape(both.shape)
    # A direct connection takes no iteration to speak of; one unit keeps the ratio finite.
    ranked = np.maximum(ranked, 1.0)
    table = ranked.reshape(len(values), -1)
    median, p90 = (
        bootstrap_interval(table, _quotient(quantile), rng, resamples=RESAMPLES) for quantile in QUANTILES
    )
    return Ratios(median, p90)


def _quotient(quantile: float) -> Callable[[Floats], Floats]:
    def statistic(rows: Floats) -> Floats:
        # (..., P, 2 R): a problem's runs of both arms, pair by pair.
        flat = rows.reshape(*rows.shape[:-2], -1, 2)
        both = np.quantile(flat, quantile, axis=-2)
        return np.asarray(both[..., 0] / both[..., 1])

    return statistic


def _arm(runs: PairedRuns, arm: Arm, uniform: Sequence[Arm], rng: np.random.Generator) -> ArmSummary:
    solved = runs.solved(arm.name)
    iterations, checks = (runs.values(arm.name, name) for name in ("iterations", "edge_checks"))
    own_best = _own_best(runs, arm, uniform)
    is_base = arm.name == arm.base
    lengths = runs.values(arm.name, "length_rad")
    times = {name: 1e3 * runs.values(arm.name, name) for name in ("request_s", "solve_s", "total_s")}
    learned = arm.sampler is not None
    return ArmSummary(
        arm=arm,
        solved=clopper_pearson(int(solved.sum()), solved.size),
        within=clopper_pearson(int((solved & (iterations <= WITHIN)).sum()), solved.size),
        iterations=summarise_censored(iterations.ravel(), ~solved.ravel()),
        edge_checks=summarise_censored(checks.ravel(), ~solved.ravel()),
        iteration_ratios=None if is_base else _ratios(runs, arm.name, arm.base, "iterations", rng),
        check_ratios=None if is_base else _ratios(runs, arm.name, arm.base, "edge_checks", rng),
        own_best=own_best,
        own_best_ratios=(
            None if own_best in (arm.base, arm.name) else _ratios(runs, arm.name, own_best, "iterations", rng)
        ),
        length_ratio=None if is_base else length_ratio(runs, arm.name, arm.base, rng),
        length_rad=float(np.nanmean(lengths)) if solved.any() else None,
        request_ms=(float(np.median(times["request_s"])), float(np.quantile(times["request_s"], 0.9))),
        solve_ms=summarise_censored(times["solve_s"].ravel(), ~solved.ravel()),
        total_ms=summarise_censored(times["total_s"].ravel(), ~solved.ravel()),
        break_even_base=_break_even(runs, arm, [arm.base], rng) if learned else None,
        break_even_best=(
            _break_even(runs, arm, [one.name for one in uniform], rng) if learned and uniform else None
        ),
    )


def _own_best(runs: PairedRuns, arm: Arm, uniform: Sequence[Arm]) -> str:
    kind = _SAME.get(arm.planner, arm.planner)
    peers = [one.name for one in uniform if _SAME.get(one.planner, one.planner) == kind]
    return min(peers or [arm.base], key=lambda name: _median(runs, name))


def _median(runs: PairedRuns, arm: str) -> float:
    iterations, failed = runs.values(arm, "iterations"), ~runs.solved(arm)
    return float(np.median(np.where(failed, np.inf, iterations)))


def _ratios(runs: PairedRuns, arm: str, base: str, column: str, rng: np.random.Generator) -> Ratios:
    failed = [~runs.solved(name) for name in (arm, base)]
    return ratios(runs.values(arm, column), failed[0], runs.values(base, column), failed[1], rng)


def length_ratio(runs: PairedRuns, arm: str, base: str, rng: np.random.Generator) -> Interval | None:
    """Summed length of the first solutions over the base's, where both runs of a pair succeeded."""
    both = runs.solved(arm) & runs.solved(base)
    sums = [
        np.where(both, np.nan_to_num(runs.values(name, "first_length_rad")), 0.0).sum(axis=1)
        for name in (arm, base)
    ]
    some = both.any(axis=1)
    return ratio_of_sums_interval(sums[0][some], sums[1][some], rng) if some.any() else None


def _break_even(runs: PairedRuns, arm: Arm, others: Sequence[str], rng: np.random.Generator) -> BreakEven:
    return break_even(spent(runs, arm.name), [spent(runs, name) for name in others], rng, RESAMPLES)
