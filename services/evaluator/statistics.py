"""Estimates with their uncertainty: bootstrap over scenarios, exact binomial limits, censored runs.

An empty group is an error and never a zero. Resampling draws from the generator that is passed in.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest

from cspace.errors import EvaluationError

Floats = NDArray[np.float64]
# Takes (..., n, k) resampled rows and returns (...,) estimates.
Statistic = Callable[[Floats], Floats]

CONFIDENCE = 0.95
RESAMPLES = 4000


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate between its confidence limits, from ``count`` independent units."""

    estimate: float
    low: float
    high: float
    count: int
    confidence: float = CONFIDENCE

    def __format__(self, spec: str) -> str:
        """``f"{interval:.3f}"`` reads ``0.857 [0.841, 0.872]``."""
        spec = spec or ".3f"
        return f"{self.estimate:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"

    def scaled(self, factor: float) -> "Interval":
        """The interval of the estimate times a positive factor."""
        return replace(self, estimate=factor * self.estimate, low=factor * self.low, high=factor * self.high)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def bootstrap_interval(
    table: ArrayLike,
    statistic: Statistic,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
) -> Interval:
    """Percentile bootstrap over the rows of a table (Efron 1979).

    Args:
        table: (n,) or (n, k), one row per scenario; the columns of a row stay together.
        statistic: (..., n, k) to (...,).
        rng: source of the resampling.
        resamples: number of bootstrap tables.

    Raises:
        EvaluationError: no rows, or a value that is not finite.
    """
    rows = _rows(table)
    picks = rng.integers(0, rows.shape[0], size=(resamples, rows.shape[0]))
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(statistic(rows[picks]), [tail, 1.0 - tail])
    return Interval(float(statistic(rows)), float(low), float(high), rows.shape[0])


def log_losses(
    confidence: NDArray[np.floating], free: NDArray[np.bool_], least: float
) -> NDArray[np.float64]:
    """-log of what each confidence gave to what happened; none counts as surer than ``least`` leaves it."""
    sure = np.clip(confidence, least, 1.0 - least)
    return np.asarray(-np.where(free, np.log(sure), np.log1p(-sure)), dtype=np.float64)


def mean_interval(values: ArrayLike, rng: np.random.Generator) -> Interval:
    """Mean of (n,) values."""
    return bootstrap_interval(values, lambda rows: rows[..., 0].mean(axis=-1), rng)


def quantile_interval(values: ArrayLike, quantile: float, rng: np.random.Generator) -> Interval:
    """A quantile in [0, 1] of (n,) values."""
    return bootstrap_interval(values, lambda rows: np.quantile(rows[..., 0], quantile, axis=-1), rng)


def difference_interval(first: ArrayLike, second: ArrayLike, rng: np.random.Generator) -> Interval:
    """Mean of the paired differences ``first - second``, both (n,)."""
    return mean_interval(_pairs(first, second) @ np.array([1.0, -1.0]), rng)


def ratio_of_sums_interval(
    numerator: ArrayLike, denominator: ArrayLike, rng: np.random.Generator
) -> Interval:
    """Sum of (n,) over the sum of its pairs (n,); the pairs are resampled together."""
    return _ratio_interval(lambda rows: rows.sum(axis=-2), numerator, denominator, rng)


def ratio_of_medians_interval(
    numerator: ArrayLike, denominator: ArrayLike, rng: np.random.Generator
) -> Interval:
    """Median of (n,) positive values over the median of its pairs (n,); the pairs are resampled together."""
    return _ratio_interval(lambda rows: np.median(rows, axis=-2), numerator, denominator, rng)


def _ratio_interval(
    of: Statistic, numerator: ArrayLike, denominator: ArrayLike, rng: np.random.Generator
) -> Interval:
    def ratio(rows: Floats) -> Floats:
        both = of(rows)
        return np.asarray(both[..., 0] / both[..., 1])

    return bootstrap_interval(_pairs(numerator, denominator), ratio, rng)


def clopper_pearson(successes: int, trials: int) -> Interval:
    """Exact binomial limits of a success probability (Clopper and Pearson 1934).

    Raises:
        EvaluationError: no trials, or successes outside 0...trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise EvaluationError(
            "a success rate needs trials",
            expected="0 <= successes <= trials, trials >= 1",
            got=f"{successes} of {trials}",
        )
    limits = binomtest(int(successes), int(trials)).proportion_ci(CONFIDENCE, method="exact")
    return Interval(successes / trials, float(limits.low), float(limits.high), trials)


@dataclass(frozen=True, slots=True)
class CensoredSummary:
    """Median and 90th percentile of runs of which some were cut off.

    A quantile that falls among the censored runs is a lower bound, and its flag says so.
    """

    median: float
    p90: float
    median_is_bound: bool
    p90_is_bound: bool
    censored: int
    count: int


def summarise_censored(values: ArrayLike, censored: ArrayLike) -> CensoredSummary:
    """Quantiles in which a censored run ranks behind all others; none is dropped.

    Args:
        values: (n,) what was measured, up to the cut where censored.
        censored: (n,) whether the run was cut off.

    Raises:
        EvaluationError: no runs, or shapes that differ.
    """
    ranked, cut = censored_as_largest(values, censored), np.asarray(censored, dtype=bool)
    finished = np.sort(np.where(cut, np.inf, ranked))
    median, p90 = (float(np.quantile(ranked, q, method="higher")) for q in (0.5, 0.9))
    bounds = [bool(np.isinf(np.quantile(finished, q, method="higher"))) for q in (0.5, 0.9)]
    return CensoredSummary(median, p90, bounds[0], bounds[1], int(cut.sum()), int(cut.size))


def censored_as_largest(values: ArrayLike, censored: ArrayLike) -> Floats:
    """(n,) values in which every censored run counts as much as the largest value seen."""
    seen, cut = _rows(values)[:, 0], np.asarray(censored, dtype=bool)
    if seen.shape != cut.shape:
        raise EvaluationError(
            "values and censoring do not pair", expected=str(seen.shape), got=str(cut.shape)
        )
    return np.where(cut, seen.max(), seen)


def _pairs(first: ArrayLike, second: ArrayLike) -> Floats:
    left, right = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if left.shape != right.shape or left.ndim != 1:
        raise EvaluationError("the groups do not pair", expected=str(left.shape), got=str(right.shape))
    return np.stack([left, right], axis=1)


def _rows(table: ArrayLike) -> Floats:
    rows = np.asarray(table, dtype=np.float64)
    if rows.ndim == 1:
        rows = rows[:, None]
    if rows.ndim != 2 or rows.size == 0:
        raise EvaluationError("the group is empty", expected="at least one row", got=f"shape {rows.shape}")
    if not np.isfinite(rows).all():
        raise EvaluationError("the group holds a value that is not finite", got=str(rows[~np.isfinite(rows)]))
    return rows
