"""Estimates with their uncertainty: bootstrap over scenarios, exact binomial limits, censored runs.

Resampling uses the generator that is passed in.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, bootstrap

from cspace.errors import EvaluationError

Floats = NDArray[np.float64]
# Takes (..., n, k) resampled rows and returns (...,) estimates.
Statistic = Callable[[Floats], Floats]

CONFIDENCE = 0.95
RESAMPLES = 4000
# Resampled tables that are held at once.
_BATCH = 500


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate between its 95 % limits, from ``count`` independent units; NaN limits are unknown."""

    estimate: float
    low: float
    high: float
    count: int

    def __format__(self, spec: str) -> str:
        """``f"{interval:.3f}"`` reads ``0.857 [0.841, 0.872]``."""
        spec = spec or ".3f"
        limits = "" if np.isnan(self.low) else f" [{self.low:{spec}}, {self.high:{spec}}]"
        return f"{self.estimate:{spec}}{limits}"

    def scaled(self, factor: float) -> "Interval":
        """The interval of the estimate times a positive factor."""
        return replace(self, estimate=factor * self.estimate, low=factor * self.low, high=factor * self.high)


def point(value: float, count: int) -> Interval:
    """An estimate without limits."""
    return Interval(value, np.nan, np.nan, count)


def summary_rng(seed: int, *use: str) -> np.random.Generator:
    """The generator of a bootstrap, apart from every scenario's; each use has its own."""
    key = (99, *(crc32(one.encode()) for one in use))
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=key))


def bootstrap_interval(
    table: ArrayLike,
    statistic: Statistic,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    method: Literal["linear", "inverted_cdf"] = "linear",
) -> Interval:
    """Percentile bootstrap over the rows of an (n, ...) table, one row per scenario (Efron 1979).

    ``method`` is that of the quantiles; ``inverted_cdf`` is for statistics that may be infinite.
    """
    rows = np.asarray(table, dtype=np.float64)
    rows = rows[:, None] if rows.ndim == 1 else rows
    if not len(rows):
        raise EvaluationError("the group is empty", expected="at least one row", got="none")
    estimate = float(statistic(rows))
    if len(rows) == 1:
        return Interval(estimate, estimate, estimate, 1)
    with np.errstate(invalid="ignore"):
        drawn = bootstrap(
            (np.arange(len(rows)),),
            lambda picks, axis: statistic(rows[picks.astype(np.intp)]),  # noqa: ARG005 - scipy's form
            n_resamples=resamples,
            batch=_BATCH,
            vectorized=True,
            method="percentile",
            rng=rng,
        ).bootstrap_distribution
    low, high = np.quantile(drawn, [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0], method=method)
    return Interval(estimate, float(low), float(high), len(rows))


def log_losses(confidence: NDArray[np.floating], free: NDArray[np.bool_], least: float) -> Floats:
    """-log of what each confidence gave to what happened, with confidences kept ``least`` from 0 and 1."""
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
    return bootstrap_interval(_pairs(numerator, denominator), lambda rows: _ratio(rows.sum(axis=-2)), rng)


def ratio_of_medians_interval(
    numerator: ArrayLike, denominator: ArrayLike, rng: np.random.Generator
) -> Interval:
    """Median of (n,) positive values over the median of its pairs (n,); the pairs are resampled together."""
    return bootstrap_interval(
        _pairs(numerator, denominator), lambda rows: _ratio(np.median(rows, axis=-2)), rng
    )


def clopper_pearson(successes: int, trials: int) -> Interval:
    """Exact binomial limits of a success probability (Clopper and Pearson 1934)."""
    if trials < 1:
        raise EvaluationError("a success rate needs trials", expected="at least one", got=str(trials))
    limits = binomtest(int(successes), int(trials)).proportion_ci(CONFIDENCE, method="exact")
    return Interval(successes / trials, float(limits.low), float(limits.high), trials)


def censored_as_largest(values: ArrayLike, censored: ArrayLike) -> Floats:
    """(n,) values in which every censored run counts as much as the largest value seen."""
    seen = np.asarray(values, dtype=np.float64)
    return np.where(np.asarray(censored, dtype=bool), seen.max(), seen)


def _ratio(both: Floats) -> Floats:
    return np.asarray(both[..., 0] / both[..., 1])


def _pairs(first: ArrayLike, second: ArrayLike) -> Floats:
    return np.stack([np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)], axis=1)
