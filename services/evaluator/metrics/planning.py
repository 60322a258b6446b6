"""What samples save a planner: success, and costs beside those with uniform samples.

A run without success is censored: it counts as much as the most expensive run that was seen.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from services.evaluator.metrics import Run, Task, metric
from services.evaluator.statistics import (
    Floats,
    Interval,
    censored_as_largest,
    clopper_pearson,
    point,
    ratio_of_medians_interval,
)


def _success(values: Floats, *_: object) -> Mapping[str, Interval]:
    return {"success": clopper_pearson(int(values.sum()), len(values))}


@metric("success", Task.PLANNING, estimates=_success, logged=("learned",))
def success(run: Run) -> float:
    """Whether the path passes an independent check."""
    return float(run.success)


def _cost(name: str, values: Floats, uniform: Floats, rng: np.random.Generator) -> Mapping[str, Interval]:
    costs = censored_as_largest(values[:, 0], values[:, 1] == 0.0)
    median, p90 = np.quantile(costs, [0.5, 0.9], method="higher").tolist()
    # Both share the largest value, so that a failure weighs the same on either side. A direct connection
    # takes no iteration to speak of; one unit keeps the ratio finite.
    both = np.concatenate([uniform, values])
    theirs, ours = np.split(np.maximum(censored_as_largest(both[:, 0], both[:, 1] == 0.0), 1.0), 2)
    return {
        f"{name}_ratio": ratio_of_medians_interval(theirs, ours, rng),
        f"{name}_median": point(median, len(costs)),
        f"{name}_p90": point(p90, len(costs)),
    }


@metric("iterations", Task.PLANNING, estimates=partial(_cost, "iterations"), logged=("learned",))
def iterations(run: Run) -> tuple[float, float]:
    """Iterations until the planner stopped, and whether it succeeded."""
    return run.iterations, run.success


@metric("edge_checks", Task.PLANNING, estimates=partial(_cost, "edge_checks"), logged=("learned",))
def edge_checks(run: Run) -> tuple[float, float]:
    """Edge checks until the planner stopped, and whether it succeeded."""
    return run.edge_checks, run.success
