"""From which cost of a collision check on a learned sampler is worth its time.

With checks that cost ``c`` seconds each, a run takes ``T(c) = fixed + checks c``: ``fixed`` is what does not
depend on the checks, that is the request for samples and the planner's own work. Both are sums over the same
problems, a run without success counted up to its limit. Two such lines cross once at most, so the costs at
which one planner beats another are all, none, or those on one side of ``(fixed_1 - fixed_2) / (checks_2 -
checks_1)``; those at which it beats several are what these sets share.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from services.evaluator.statistics import CONFIDENCE, RESAMPLES

Floats = NDArray[np.float64]


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
