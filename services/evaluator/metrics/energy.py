"""Energy distance to real samples, and EDr, its sum over scenarios relative to uniform samples."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist

from cspace.space import JointSpace
from services.evaluator.metrics import Samples, metric
from services.evaluator.statistics import Floats, Interval, ratio_of_sums_interval


def _edr(values: Floats, uniform: Floats, rng: np.random.Generator) -> Mapping[str, Interval]:
    return {"edr": ratio_of_sums_interval(values[:, 0], uniform[:, 0], rng)}


@metric("energy", estimates=_edr)
def energy(group: Samples) -> float:
    """Energy distance to the held-out configurations."""
    return energy_distance(group.samples, group.held_out, group.space)


def energy_distance(first: NDArray[np.floating], second: NDArray[np.floating], space: JointSpace) -> float:
    """2 E|X - Y| - E|X - X'| - E|Y - Y'| on the space's embedding of (N, d) and (M, d).

    Unbiased: no point is paired with itself, so that equal distributions average zero and single values may
    lie slightly below. No root is taken (Szekely and Rizzo 2013).
    """
    x, y = space.embed(first), space.embed(second)
    return float(2.0 * cdist(x, y).mean() - pdist(x).mean() - pdist(y).mean())
