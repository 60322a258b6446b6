"""How unlike the training scenarios a picture is: scores of a graph to one calibrated percentile."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

QUANTILES = 101


def novelty(scores: NDArray[np.float32], quantiles: Sequence[Sequence[float]]) -> float:
    """The share of known pictures that are less unusual, 0 to 1; 1 beyond all of them.

    Every score is ranked among those of known pictures. The highest rank counts, and as the highest of
    several is high more often than each (Bonferroni), its distance from 1 is multiplied by their number.

    Args:
        scores: (s,), each higher for what is less usual.
        quantiles: for each score its rising quantiles over known pictures, evenly spaced from 0 to 1.
    """
    ranks = [
        float(np.interp(score, known, np.linspace(0.0, 1.0, len(known))))
        for score, known in zip(scores.tolist(), quantiles, strict=True)
    ]
    return max(0.0, 1.0 - len(ranks) * (1.0 - max(ranks)))


def quantiles_of(scores: NDArray[np.floating]) -> tuple[tuple[float, ...], ...]:
    """Evenly spaced quantiles of (n, s) scores of known pictures, s rows of 101 values."""
    found = np.quantile(scores.astype(np.float64), np.linspace(0.0, 1.0, QUANTILES), axis=0).T
    return tuple(tuple(row) for row in found.tolist())
