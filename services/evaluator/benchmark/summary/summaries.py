"""What the runs of one family say of each arm: quantiles with censored runs, ratios with intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm, Group
from services.evaluator.benchmark.summary.break_even import BreakEven, Spent, break_even
from services.evaluator.benchmark.summary.paired import Flags, Floats, PairedRuns
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    bootstrap_interval,
    censored_as_largest,
    clopper_pearson,
    ratio_of_sums_interval,
    summarise_censored,
)
from services.planner.plan_result import Reason
from services.planner.settings import RRT_CONNECT, SAMPLED_CONNECT

WITHIN = 1000
PARTS = ("request", "server", "transport", "check")
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
class Worth:
    """From which cost of a check on learned samples save wall time.

    Args:
        edge_base: cost of an edge check, over the same planner with uniform samples.
        edge_best: likewise, over every uniform planner.
        state_base: cost of a look at one state, over the same planner with uniform samples.
        state_best: likewise, over every uniform planner.
    """

    edge_base: BreakEven
    edge_best: BreakEven
    state_base: BreakEven
    state_best: BreakEven


@dataclass(frozen=True, slots=True)
class ArmSummary:
    """One arm on one family.

    Args:
        arm: what was run.
        solved: share that was solved at all.
        rejected: runs whose path the independent check refused; they are not solved.
        within: share that was solved within ``WITHIN`` iterations.
        iterations: quantiles; runs without success rank last.
        edge_checks: likewise.
        iteration_ratios: to the base; None for a base.
        check_ratios: likewise.
        own_best: name of the best uniform arm of the same planner, over ranges and programs.
        own_best_ratios: iterations to that of ``own_best``; None where it is the base.
        length_ratio: first solutions' lengths over the base's, where both succeeded; None where none did.
        length_rad: mean length of the paths found, None where there are none.
        parts_ms: median and 90th percentile of the request, of what of it the server and the transport took,
            and of the checks.
        solve_ms: likewise, of the search; runs without success rank last.
        total_ms: likewise, of both.
        worth: break-even costs of a check; None for uniform arms.
    """

    arm: Arm
    solved: Interval
    rejected: int
    within: Interval
    iterations: CensoredSummary
    edge_checks: CensoredSummary
    iteration_ratios: Ratios | None
    check_ratios: Ratios | None
    own_best: str
    own_best_ratios: Ratios | None
    length_ratio: Interval | None
    length_rad: float | None
    parts_ms: Mapping[str, tuple[float, float]]
    solve_ms: CensoredSummary
    total_ms: CensoredSummary
    worth: Worth | None


def summarise(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> list[ArmSummary]:
    """All arms that end with their first solution, in the order given.

    Args:
        runs: of one family.
        arms: that were run; those that optimise are for
            :mod:`services.evaluator.benchmark.summary.convergence`.
        rng: source of the resampling.

    Raises:
        EvaluationError: an arm has no runs.
    """
    present = [arm for arm in arms if arm.stop_at_first and arm.name in runs.arms]
    uniform = [arm for arm in present if arm.group is Group.UNIFORM]
    return [_arm(runs, arm, uniform, rng) for arm in present]


def spent(runs: PairedRuns, arm: str, checks: str = "edge_checks") -> Spent:
    """What an arm took apart from its checks, and how many those were, by problem.

    Args:
        runs: of one family.
        arm: its name.
        checks: the column that counts them: ``edge_checks`` or ``state_checks``.
    """
    request_s, solve_s = runs.values(arm, "request_s"), runs.values(arm, "solve_s")
    fixed_s = request_s + solve_s - runs.values(arm, "check_s")
    return Spent(fixed_s.sum(axis=1), runs.values(arm, checks).sum(axis=1))


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
    times = {name: 1e3 * runs.values(arm.name, name) for name in ("solve_s", "total_s")}
    return ArmSummary(
        arm=arm,
        solved=clopper_pearson(int(solved.sum()), solved.size),
        rejected=sum(run.reason == Reason.REJECTED for run in runs.runs(arm.name)),
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
        parts_ms={name: _median_p90(1e3 * runs.values(arm.name, f"{name}_s")) for name in PARTS},
        solve_ms=summarise_censored(times["solve_s"].ravel(), ~solved.ravel()),
        total_ms=summarise_censored(times["total_s"].ravel(), ~solved.ravel()),
        worth=None if arm.sampler is None else _worth(runs, arm, uniform, rng),
    )


def _median_p90(values: Floats) -> tuple[float, float]:
    return float(np.median(values)), float(np.quantile(values, 0.9))


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


def _worth(runs: PairedRuns, arm: Arm, uniform: Sequence[Arm], rng: np.random.Generator) -> Worth:
    every = [one.name for one in uniform] or [arm.base]
    found = [
        break_even(
            spent(runs, arm.name, checks), [spent(runs, one, checks) for one in others], rng, RESAMPLES
        )
        for checks in ("edge_checks", "state_checks")
        for others in ([arm.base], every)
    ]
    return Worth(*found)
