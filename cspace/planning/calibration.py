"""From the cost of a path to the probability that it is free, fitted to paths that were checked."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from cspace.planning.cost import confidence_of_cost

_LEAST = 1e-6


def fit_calibration(
    cost: NDArray[np.float64],
    free: NDArray[np.bool_],
    prior: float = 4.0,
    usual: tuple[float, float] = (0.0, 1.0),
) -> tuple[float, float]:
    """(a, b) by which paths of a cost D are free with exp(-exp(a + b log D)), by maximum likelihood.

    ``cost``: (n,), not negative. ``free``: (n,). ``prior``: precision, halved, of a normal prior of a and b
    at ``usual``, of which (0, 1) leaves the cost as it is.
    """
    cost = np.maximum(cost, _LEAST)

    def loss(parameters: NDArray[np.float64]) -> float:
        confidence = confidence_of_cost(cost, (parameters[0], parameters[1]))
        confidence = np.clip(confidence, _LEAST, 1.0 - _LEAST)
        pull = prior * ((parameters[0] - usual[0]) ** 2 + (parameters[1] - usual[1]) ** 2)
        return float(pull - np.where(free, np.log(confidence), np.log1p(-confidence)).sum())

    found = minimize(loss, np.array(usual), method="L-BFGS-B", bounds=[(-10.0, 10.0), (0.05, 10.0)])
    return float(found.x[0]), float(found.x[1])
