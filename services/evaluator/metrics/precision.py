"""Precision: the collision-free share of samples."""

from collections.abc import Mapping

import numpy as np

from services.evaluator.metrics import Samples, metric
from services.evaluator.statistics import (
    Floats,
    Interval,
    difference_interval,
    mean_interval,
    point,
    quantile_interval,
)

LOW_QUANTILE = 0.1


def _estimates(values: Floats, uniform: Floats, rng: np.random.Generator) -> Mapping[str, Interval]:
    shares = values[:, 0]
    return {
        "precision": mean_interval(shares, rng),
        "precision_gain": difference_interval(shares, uniform[:, 0], rng),
        "precision_p10": quantile_interval(shares, LOW_QUANTILE, rng),
        "precision_minimum": point(float(shares.min()), len(shares)),
    }


@metric("precision", estimates=_estimates, logged=("sampler", "confident", "uniform"), by_family=True)
def precision(group: Samples) -> float:
    """Share of samples that are free by an exact check."""
    return float(np.mean(group.is_free(group.samples)))
