"""Quality of a validity head: accuracy, above all near contact, calibration, and what its filter passes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services.evaluator.statistics import (
    Interval,
    bootstrap_interval,
    mean_interval,
    ratio_of_sums_interval,
)

BINS = 15
# Of the table of bins, which is wide.
RESAMPLES = 1000


@dataclass(frozen=True, slots=True)
class SceneOccupancy:
    """A head on the uniform configurations of one scenario.

    Args:
        accuracy: share told rightly at a confidence of 0.5.
        near_right: how many near contact, on either side of it, were told rightly.
        near: how many there were.
        counts: configurations in each of 15 equal bins of confidence.
        confidences: sum of the confidences in each.
        free: how many in each are free.
        acceptance: share of the generator's samples whose confidence reaches the bundle's threshold.
    """

    accuracy: float
    near_right: int
    near: int
    counts: tuple[int, ...]
    confidences: tuple[float, ...]
    free: tuple[int, ...]
    acceptance: float


@dataclass(frozen=True, slots=True)
class OccupancySummary:
    """A head over all scenarios.

    Args:
        accuracy: mean over scenarios.
        near_accuracy: over all configurations near contact; None when there were none.
        calibration_error: expected calibration error (Naeini et al. 2015), 15 bins.
        acceptance: of the generator's samples.
        reliability: (mean confidence, free share, count) of every bin that holds something.
    """

    accuracy: Interval
    near_accuracy: Interval | None
    calibration_error: Interval
    acceptance: Interval
    reliability: tuple[tuple[float, float, int], ...]


def scene_occupancy(
    confidence: NDArray[np.floating],
    free: NDArray[np.bool_],
    clearance_m: NDArray[np.floating],
    acceptance: float,
    near_contact_m: float,
) -> SceneOccupancy:
    """Compare (N,) confidences with the truth.

    Args:
        confidence: P(free) of uniform configurations.
        free: whether they are.
        clearance_m: signed distance to contact.
        acceptance: of the generator's samples.
        near_contact_m: clearance up to which a configuration is near contact.
    """
    right = (confidence >= 0.5) == free
    near = np.abs(clearance_m) < near_contact_m
    bins = np.minimum((confidence * BINS).astype(np.int64), BINS - 1)
    return SceneOccupancy(
        accuracy=float(right.mean()),
        near_right=int(right[near].sum()),
        near=int(near.sum()),
        counts=tuple(np.bincount(bins, minlength=BINS).tolist()),
        confidences=tuple(np.bincount(bins, confidence, minlength=BINS).tolist()),
        free=tuple(np.bincount(bins[free], minlength=BINS).tolist()),
        acceptance=acceptance,
    )


def summarise_occupancy(rows: Sequence[SceneOccupancy], rng: np.random.Generator) -> OccupancySummary:
    """Summaries with bootstrap intervals over scenarios.

    Raises:
        EvaluationError: no scenarios.
    """
    # Scenarios whose obstacles are all out of reach have nothing near contact and say nothing about it.
    touched = [row for row in rows if row.near]
    table = np.array([[*row.counts, *row.confidences, *row.free] for row in rows], dtype=np.float64)
    return OccupancySummary(
        accuracy=mean_interval([row.accuracy for row in rows], rng),
        near_accuracy=ratio_of_sums_interval(
            [row.near_right for row in touched], [row.near for row in touched], rng
        )
        if touched
        else None,
        calibration_error=bootstrap_interval(table, _calibration_error, rng, resamples=RESAMPLES),
        acceptance=mean_interval([row.acceptance for row in rows], rng),
        reliability=_reliability(table.sum(axis=0)),
    )


def _calibration_error(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean over configurations of |confidence - free share| of their bin: (..., n, 3 bins) to (...)."""
    counts, confidences, free = np.split(rows.sum(axis=-2), 3, axis=-1)
    error: NDArray[np.float64] = np.abs(confidences - free).sum(axis=-1) / counts.sum(axis=-1)
    return error


def _reliability(sums: NDArray[np.float64]) -> tuple[tuple[float, float, int], ...]:
    counts, confidences, free = np.split(sums, 3)
    return tuple(
        (float(total / count), float(right / count), int(count))
        for count, total, right in zip(counts, confidences, free, strict=True)
        if count
    )


def reliability_diagram(head: OccupancySummary, title: str) -> Figure:
    """Free share over mean confidence by bin, with how many configurations each bin holds below it."""
    figure = Figure(figsize=(4.6, 5.4), layout="constrained")
    shares, sizes = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    confidence, free, counts = zip(*head.reliability, strict=True)
    shares.plot([0.0, 1.0], [0.0, 1.0], color="#999999", linewidth=1.0, label="calibrated")
    shares.plot(confidence, free, marker="o", markersize=4, linewidth=1.2, label="validity head")
    shares.set(ylabel="free share", xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    shares.set_title(f"{title}\nexpected calibration error {head.calibration_error:.4f}", fontsize=9)
    shares.legend(loc="upper left", fontsize=8)
    sizes.bar(confidence, counts, width=0.05)
    sizes.set(xlabel="confidence", ylabel="configurations", yscale="log")
    return figure
