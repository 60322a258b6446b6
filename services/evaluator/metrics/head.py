"""Quality of a validity head: accuracy, above all near contact, calibration, and what its filter accepts."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from services.evaluator.metrics import Head, Task, metric
from services.evaluator.statistics import Floats, Interval, bootstrap_interval, ratio_of_sums_interval

BINS = 15
# Of the table of bins, which is wide.
RESAMPLES = 1000


@metric("accuracy", Task.HEAD)
def accuracy(head: Head) -> float:
    """Share classified correctly at a confidence of 0.5."""
    return float(np.mean((head.confidence >= 0.5) == head.free))


def _near_accuracy(values: Floats, _: Floats, rng: np.random.Generator) -> Mapping[str, Interval]:
    # Scenarios whose obstacles are all out of reach have nothing near contact.
    right, count = values[values[:, 1] > 0].T
    return {"near_accuracy": ratio_of_sums_interval(right, count, rng)} if len(count) else {}


@metric("near", Task.HEAD, estimates=_near_accuracy, logged=())
def near(head: Head) -> tuple[int, int]:
    """How many configurations near contact are classified correctly, and how many there are."""
    close = np.abs(head.clearance_m) < head.near_contact_m
    right = (head.confidence >= 0.5) == head.free
    return int(right[close].sum()), int(close.sum())


def _calibration_error(values: Floats, _: Floats, rng: np.random.Generator) -> Mapping[str, Interval]:
    return {"calibration_error": bootstrap_interval(values, calibration_error, rng, resamples=RESAMPLES)}


@metric("calibration", Task.HEAD, estimates=_calibration_error, logged=())
def calibration(head: Head) -> Floats:
    """For each of 15 equal bins of confidence the count, the summed confidence, and how many are free."""
    bins = np.minimum((head.confidence * BINS).astype(np.int64), BINS - 1)
    return np.concatenate(
        [np.bincount(bins, weights, minlength=BINS) for weights in (None, head.confidence, head.free)]
    )


@metric("acceptance", Task.HEAD, logged=())
def acceptance(head: Head) -> float:
    """Share of the generator's samples that reach the threshold."""
    return head.acceptance


def calibration_error(rows: Floats) -> Floats:
    """Expected calibration error (Naeini et al. 2015) of (..., n, 3 bins) scenarios together, (...)."""
    counts, confidences, free = np.split(rows.sum(axis=-2), 3, axis=-1)
    error: Floats = np.abs(confidences - free).sum(axis=-1) / counts.sum(axis=-1)
    return error


def reliability_diagram(values: Floats, title: str) -> Figure:
    """Free share over mean confidence by bin, and the size of each bin, of (n, 3 bins) scenarios."""
    counts, confidences, free = np.split(values.sum(axis=0), 3)
    filled = counts > 0
    confidence, share = confidences[filled] / counts[filled], free[filled] / counts[filled]
    figure = Figure(figsize=(4.6, 5.4), layout="constrained")
    shares, sizes = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    shares.plot([0.0, 1.0], [0.0, 1.0], color="#999999", linewidth=1.0, label="calibrated")
    shares.plot(confidence, share, marker="o", markersize=4, linewidth=1.2, label="validity head")
    shares.set(ylabel="free share", xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    shares.set_title(
        f"{title}\nexpected calibration error {float(calibration_error(values)):.4f}", fontsize=9
    )
    shares.legend(loc="upper left", fontsize=8)
    sizes.bar(confidence, counts[filled], width=0.05)
    sizes.set(xlabel="confidence", ylabel="configurations", yscale="log")
    return figure
