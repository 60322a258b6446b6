"""Runs reduced to numbers with intervals: censored quantiles, paired ratios, break-even costs."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from services.evaluator.benchmark.arms import Arm, Group
from services.evaluator.benchmark.store import Run
from services.evaluator.statistics import (
    CONFIDENCE,
    RESAMPLES,
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

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class PairedRuns:
    """Runs of one family, every arm on the same problems as often.

    Args:
        runs: of one family, complete.

    Raises:
        EvaluationError: none, of several families, or an arm lacks a run.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        families = sorted({run.family for run in runs})
        if len(families) != 1:
            raise EvaluationError("runs are paired within one family", expected="one", got=str(families))
        self.family = families[0]
        self.problems = tuple(sorted({run.problem for run in runs}))
        self.numbers = tuple(sorted({run.run for run in runs}))
        self._by_arm: dict[str, dict[tuple[int, int], Run]] = {}
        for run in runs:
            self._by_arm.setdefault(run.arm, {})[run.problem, run.run] = run
        pairs = {(problem, number) for problem in self.problems for number in self.numbers}
        for arm, mine in self._by_arm.items():
            if set(mine) != pairs:
                raise EvaluationError(
                    f"the arm {arm} lacks runs", expected=str(len(pairs)), got=str(len(mine))
                )

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(self._by_arm)

    def runs(self, arm: str) -> list[Run]:
        """All runs of an arm, problem by problem.

        Raises:
            EvaluationError: there is no such arm.
        """
        if arm not in self._by_arm:
            raise EvaluationError("there is no such arm", expected=", ".join(self._by_arm), got=arm)
        mine = self._by_arm[arm]
        return [mine[problem, number] for problem in self.problems for number in self.numbers]

    def values(self, arm: str, column: str) -> Floats:
        """(P, R) values of a column; nan where a run has none."""
        found = [getattr(run, column) for run in self.runs(arm)]
        numbers = [np.nan if value is None else float(value) for value in found]
        return np.array(numbers).reshape(len(self.problems), len(self.numbers))

    def solved(self, arm: str) -> Flags:
        """(P, R) whether a run succeeded."""
        return self.values(arm, "solved").astype(bool)


@dataclass(frozen=True, slots=True)
class TimeLine:
    """The time of some runs as a function of what a check costs.

    Args:
        fixed_s: that does not depend on it.
        checks: how many.
    """

    fixed_s: float
    checks: float

    def total_s(self, check_s: float) -> float:
        """The time at a cost of a check, in s."""
        return self.fixed_s + self.checks * check_s


@dataclass(frozen=True, slots=True)
class WinningCosts:
    """The costs of a check, in s, between which one planner takes less time than others.

    Args:
        low_s: 0 where it wins with free checks.
        high_s: infinite where it wins however dear they are.
    """

    low_s: float
    high_s: float

    @property
    def never(self) -> bool:
        """Whether there are none."""
        return self.low_s >= self.high_s

    @property
    def always(self) -> bool:
        """Whether it wins at any cost."""
        return self.low_s == 0.0 and math.isinf(self.high_s)


NEVER = WinningCosts(math.inf, math.inf)


def winning_costs(learned: TimeLine, others: Sequence[TimeLine]) -> WinningCosts:
    """Where a planner takes less time than each of the others.

    Raises:
        EvaluationError: there are no others.
    """
    if not others:
        raise EvaluationError("there is nothing to compare with", expected="one or more", got="none")
    low_s, high_s = 0.0, math.inf
    for other in others:
        dearer_s, fewer = learned.fixed_s - other.fixed_s, other.checks - learned.checks
        if fewer > 0.0:
            low_s = max(low_s, dearer_s / fewer)
        elif dearer_s >= 0.0:
            return NEVER
        elif fewer < 0.0:
            high_s = min(high_s, dearer_s / fewer)
    return WinningCosts(low_s, high_s) if low_s < high_s else NEVER


@dataclass(frozen=True, slots=True, eq=False)
class Spent:
    """What an arm took, problem by problem.

    Args:
        fixed_s: (P,) request and the planner's own work, in s; sums over the runs of a problem.
        checks: (P,) edge checks, likewise.
    """

    fixed_s: Floats
    checks: Floats

    def total(self) -> TimeLine:
        """The line of the sums over all problems."""
        return TimeLine(float(self.fixed_s.sum()), float(self.checks.sum()))

    def totals(self, rows: NDArray[np.intp]) -> list[TimeLine]:
        """The lines of the sums over so many sets of problems, (sets, P) their numbers."""
        sums = zip(
            self.fixed_s[rows].sum(axis=1).tolist(), self.checks[rows].sum(axis=1).tolist(), strict=True
        )
        return [TimeLine(fixed_s, checks) for fixed_s, checks in sums]

    def typical(self) -> TimeLine:
        """The line of the medians."""
        return TimeLine(float(np.median(self.fixed_s)), float(np.median(self.checks)))


@dataclass(frozen=True, slots=True)
class BreakEven:
    """The costs at which a learned sampler wins, with their uncertainty over problems.

    Args:
        costs: from the sums over all problems.
        low_s: 95 % limits of ``costs.low_s``; infinite where it never wins.
        high_s: 95 % limits of ``costs.high_s``.
        typical: the same from medians instead of sums.
        never_share: of the resampled problem sets, in which it never wins.
    """

    costs: WinningCosts
    low_s: tuple[float, float]
    high_s: tuple[float, float]
    typical: WinningCosts
    never_share: float


def break_even(
    learned: Spent, others: Sequence[Spent], rng: np.random.Generator, resamples: int = RESAMPLES
) -> BreakEven:
    """Where a learned sampler beats each of some uniform planners, by bootstrap over problems.

    Args:
        learned: the arm with learned samples.
        others: the uniform ones, on the same problems.
        rng: source of the resampling.
        resamples: number of resampled problem sets.

    Raises:
        EvaluationError: no problems, or arms on other problems.
    """
    count = len(learned.checks)
    if not count or any(len(other.checks) != count for other in others):
        raise EvaluationError("arms are compared on the same problems", got=f"{count} and others")
    rows = rng.integers(0, count, size=(resamples, count))
    against = zip(*(other.totals(rows) for other in others), strict=True)
    found = [winning_costs(mine, theirs) for mine, theirs in zip(learned.totals(rows), against, strict=True)]
    return BreakEven(
        winning_costs(learned.total(), [other.total() for other in others]),
        _limits([one.low_s for one in found]),
        _limits([one.high_s for one in found]),
        winning_costs(learned.typical(), [other.typical() for other in others]),
        float(np.mean([one.never for one in found])),
    )


def _limits(values: Sequence[float]) -> tuple[float, float]:
    tail = (1.0 - CONFIDENCE) / 2.0
    # One of the values, never between two: halfway to infinity is no number.
    low, high = np.quantile(values, [tail, 1.0 - tail], method="inverted_cdf")
    return float(low), float(high)


def in_words(found: BreakEven) -> str:
    """``above 21 us [17, 26]``, ``always``, ``never``, or what else there is."""
    costs, words = found.costs, costs_in_words(found.costs)
    if costs.always and found.low_s[1] == 0.0:
        return words
    if costs.never and math.isinf(found.low_s[0]):
        return words
    edge = found.high_s if costs.low_s == 0.0 and not math.isinf(costs.high_s) else found.low_s
    return f"{words} [{_us(edge[0])}, {_us(edge[1])}]"


def costs_in_words(costs: WinningCosts) -> str:
    """The same without limits."""
    if costs.never or costs.always:
        return "never" if costs.never else "always"
    if math.isinf(costs.high_s):
        return f"above {_us(costs.low_s)} us"
    if costs.low_s == 0.0:
        return f"below {_us(costs.high_s)} us"
    return f"between {_us(costs.low_s)} and {_us(costs.high_s)} us"


def _us(seconds: float) -> str:
    if math.isinf(seconds):
        return "never"
    return f"{1e6 * seconds:.3g}" if seconds < 1e-3 else f"{1e6 * seconds:.0f}"


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
            :mod:`services.evaluator.benchmark.results`.
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
