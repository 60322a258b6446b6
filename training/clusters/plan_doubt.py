"""How likely plans are free that a bundle doubts so much: fitted to plans in validation scenes.

A plan is chosen for its small doubt, and ways are long and their states alike, so that exp(-D) need not be a
probability. exp(-exp(a + b log D)), the complementary log-log link, keeps 1 where there is no doubt and falls
with it; (0, 1) is exp(-D), to which few plans are pulled. Two thirds of the plans fit, the others measure.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from cspace.bundle import Bundle, BundleSpec
from cspace.connecting import spaced
from cspace.planning.query import PlanQuery
from cspace.planning.scoring import calibration_error, free_of_doubt
from cspace.splits import Split
from cspace.world import World
from cspace.worlds import checker_of, picture_of, workshop_of

# Of problems, apart from those that the evaluator draws.
SEED = 46
# A way is judged at half of what planners look at.
_FINER = 0.5
# How hard (a, b) is pulled to (0, 1), in plans.
_PULL = 4.0
_LEAST = 1e-6


@dataclass(frozen=True, slots=True)
class Planned:
    """The surest ways of validation problems.

    Args:
        doubt: (n,) of each, see :mod:`cspace.planning.scoring`.
        free: (n,) whether it is, in truth.
    """

    doubt: NDArray[np.float64]
    free: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PlanDoubt:
    """What was fitted, and how it did with plans that had no part in it.

    Args:
        parameters: (a, b).
        fitted: plans that it was fitted to.
        measured: other plans.
        collide: share of these that collide.
        error: calibration error of their confidence, ten bins.
        plain_error: the same of exp(-D).
    """

    parameters: tuple[float, float]
    fitted: int
    measured: int
    collide: float
    error: float
    plain_error: float

    def metrics(self) -> dict[str, float]:
        """As a bundle's provenance holds it."""
        told = {
            "fitted": float(self.fitted),
            "measured": float(self.measured),
            "measured_collide": self.collide,
            "measured_calibration_error": self.error,
            "measured_calibration_error_of_exp_minus_doubt": self.plain_error,
        }
        return {f"plans/{name}": value for name, value in told.items()}

    def stated_in(self, spec: BundleSpec) -> BundleSpec:
        """A bundle's description with what was fitted."""
        provenance = replace(spec.provenance, metrics={**spec.provenance.metrics, **self.metrics()})
        return replace(spec, plan_doubt=self.parameters, provenance=provenance)


def planned(bundle: Bundle, world: World, problems: int) -> Planned:
    """Plan in so many validation problems, of all solvable families in turn, and judge what comes of it.

    Searches end by their own effort and not by a clock, so that the same seed gives the same bundle.
    """
    shop = workshop_of(world)
    families, measures = shop.families.solvable, shop.measures
    doubts, free = [], []
    for number in range(problems):
        family, index = families[number % len(families)], number // len(families)
        problem = shop.problem(family, Split.VALIDATION, SEED, index)
        start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
        query = PlanQuery(start, goal, number, 0.0, math.inf)
        found = bundle.plan(bundle.prepare(picture_of(problem.scenario)), query)
        if not len(found.way):
            continue
        states = spaced(found.way, world.space, _FINER * measures.resolution_rad)
        doubts.append(found.doubt)
        free.append(bool(checker_of(problem.scenario).valid_batch(states).all()))
    return Planned(np.array(doubts, dtype=np.float64), np.array(free, dtype=np.bool_))


def fit_plan_doubt(plans: Planned) -> PlanDoubt | None:
    """Fit, and measure; None where there are too few plans to say anything."""
    fits = np.arange(len(plans.doubt)) % 3 < 2
    if not fits.any() or fits.all():
        return None
    doubt, free = np.maximum(plans.doubt, _LEAST), plans.free

    def loss(parameters: NDArray[np.float64]) -> float:
        sure = free_of_doubt(doubt[fits], (parameters[0], parameters[1]))
        sure = np.clip(sure, _LEAST, 1.0 - _LEAST)
        pull = _PULL * (parameters[0] ** 2 + (parameters[1] - 1.0) ** 2)
        return float(pull - np.where(free[fits], np.log(sure), np.log1p(-sure)).sum())

    found = minimize(loss, np.array([0.0, 1.0]), method="L-BFGS-B", bounds=[(-10.0, 10.0), (0.05, 10.0)])
    parameters = (float(found.x[0]), float(found.x[1]))
    others, in_truth = doubt[~fits], free[~fits]
    return PlanDoubt(
        parameters=parameters,
        fitted=int(fits.sum()),
        measured=len(others),
        collide=float(1.0 - in_truth.mean()),
        error=calibration_error(free_of_doubt(others, parameters), in_truth),
        plain_error=calibration_error(np.exp(-others), in_truth),
    )
