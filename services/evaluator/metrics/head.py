"""Quality of a validity head: accuracy, above all near contact, calibration, and what its filter accepts."""

from collections.abc import Mapping

import numpy as np

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
