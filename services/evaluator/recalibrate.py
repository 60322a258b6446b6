"""Fit the confidence of plans to the outcomes of one site: ``python -m services.evaluator recalibrate``.

A calibration has two parameters (:mod:`cspace.planning.calibration`) upon those of the bundle, with a prior
that leaves these as they are, so that a few dozen outcomes suffice. Each becomes a version of the model
``calibration-SITE``; ``POST /plan`` with this ``site`` uses the champion. It becomes that if such fits
predict better what they were not fitted to.
"""

import argparse
import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.errors import ConfigError, CspaceError, EvaluationError, InputError, RegistryError
from cspace.planning.calibration import fit_calibration
from cspace.planning.cost import calibration_error, confidence_of_cost
from services.command_errors import report_error
from services.evaluator import stores
from services.evaluator.statistics import log_losses
from services.names import (
    ALIAS_CHAMPION,
    CALIBRATIONS_EXPERIMENT,
    OUTCOMES_FILE,
    SITE_PATTERN,
    TAG_MODEL,
    TAG_STAGE,
)
from services.outcomes import uploaded
from services.registry.calibration import SiteCalibration, calibration_name
from services.registry.ports import ModelRegistry, ModelVersion, Tracking

LEAST_PLANS, FOLDS = 20, 5
# Weaker than that of a bundle, for sites may be quite unlike training: 200 plans that were drawn with offset
# 2 and slope 0.6 then leave an error of 0.03 instead of 0.06, those that fit already one of 0.014 for 0.010.
PRIOR = 1.0
_LEAST = 1e-6
AS_IT_IS = (0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Plans:
    """Executed or checked plans of one site and model version.

    Args:
        model: ``name/version``.
        cost: (n,) -log of the model's own confidence in each.
        free: (n,) whether each was free.
        batches: digest of each uploaded batch by its run's id.
    """

    model: str
    cost: NDArray[np.float64]
    free: NDArray[np.bool_]
    batches: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Fit:
    """Quality of confidences that others were fitted for, and of those that were stated.

    Args:
        parameters: offset and slope, fitted to all plans.
        collide: share of the plans that collide.
        error: calibration error, ten bins, with each fifth predicted from the others.
        error_before: that of the model's own confidence.
        loss: mean of -log of what was predicted for what happened, predicted in the same way.
        loss_before: that of the model's own confidence.
    """

    parameters: tuple[float, float]
    collide: float
    error: float
    error_before: float
    loss: float
    loss_before: float

    @property
    def better(self) -> bool:
        """Whether plans that had no part in a fit are predicted better by it."""
        return self.loss < self.loss_before


@dataclass(frozen=True, slots=True)
class Recalibrated:
    """What :func:`recalibrate` made.

    Args:
        version: of the site's calibrations.
        plans: number of plans.
        fit: what was fitted.
    """

    version: ModelVersion
    plans: int
    fit: Fit


def recalibrate(site: str, model: str | None, tracking: Tracking, registry: ModelRegistry) -> Recalibrated:
    """Fit to a site's outcomes, and register; the same outcomes make the same version.

    Args:
        site: as outcomes name it.
        model: ``name/version``; None for that of most plans.
        tracking: where outcomes were uploaded.
        registry: where the calibration becomes a version.

    Raises:
        InputError: the site is no name that outcomes can have.
        EvaluationError: there are fewer than 20 plans of which it is known whether they collide.
        RegistryError: the tracking server is away, or holds something else.
    """
    if re.fullmatch(SITE_PATTERN, site, re.ASCII) is None:
        raise InputError(
            "the site is no name",
            expected="1 to 64 letters, digits, dots, dashes and underscores",
            got=repr(site)[:200],
        )
    plans = plans_of(site, model, tracking, registry)
    fit = fitted(plans.cost, plans.free)
    offset, slope = fit.parameters
    calibration = SiteCalibration(plans.model, offset, slope)
    data = plans.cost.tobytes() + plans.free.tobytes() + f"{site} {plans.model}".encode()
    tags = {TAG_STAGE: "calibration", TAG_MODEL: plans.model}
    with tracking.start(
        CALIBRATIONS_EXPERIMENT, f"{site}, {{id}}", tags=tags, key=hashlib.sha256(data).hexdigest()
    ) as run:
        run.params({"site": site, "model": plans.model, "plans": len(plans.cost)})
        run.metrics(
            {
                "offset": offset,
                "slope": slope,
                "collide": fit.collide,
                "calibration_error": fit.error,
                "calibration_error_before": fit.error_before,
                "log_loss": fit.loss,
                "log_loss_before": fit.loss_before,
            },
            0,
        )
        run.figure(reliability(plans, fit), "reliability")
        for run_id, digest in plans.batches.items():
            run.dataset("outcomes", digest, f"runs:/{run_id}/{OUTCOMES_FILE}", "calibration")
    version = registry.record(
        calibration_name(site), run.run_id, calibration.tags, alias=ALIAS_CHAMPION if fit.better else None
    )
    return Recalibrated(version, len(plans.cost), fit)


def plans_of(site: str, model: str | None, tracking: Tracking, registry: ModelRegistry) -> Plans:
    """The plans of a site in all uploaded batches; see :func:`recalibrate`."""
    rows: dict[tuple[Any, Any], tuple[dict[str, Any], str]] = {}
    digests = {}
    # From the oldest on, so that what was reported last holds.
    for run_id, digest, batch in uploaded(tracking):
        digests[run_id] = digest
        for row in batch:
            is_known = row.get("confidence") is not None and row.get("collided") is not None
            if is_known and (row["kind"], row.get("site")) == ("plan", site):
                rows[row.get("client"), row["request_id"]] = row, run_id
    models = Counter(row["model"] for row, _ in rows.values())
    chosen = model or max(models, key=models.__getitem__, default="")
    found = [(row, run_id) for row, run_id in rows.values() if row["model"] == chosen]
    if len(found) < LEAST_PLANS:
        others = ", ".join(f"{number} of {name}" for name, number in sorted(models.items()))
        raise EvaluationError(
            f"too few outcomes of plans at the site {site}",
            expected=f"at least {LEAST_PLANS} of {chosen or 'a model'}, with collided and confidence",
            got=f"{len(found)}; the site has {others or 'none'}",
            remedy="send outcomes with this site, and upload them with python -m services.outcomes",
        )
    stated = np.array([row["confidence"] for row, _ in found])
    cost = -np.log(np.clip(stated, _LEAST, 1.0 - _LEAST))
    names = [row.get("calibration") for row, _ in found]
    for name in sorted({one for one in names if one is not None}):
        # What an earlier calibration has made of the model's own confidence is undone.
        earlier = SiteCalibration.of(_version(registry, name))
        at = np.array([one == name for one in names])
        cost[at] = np.exp((np.log(cost[at]) - earlier.offset) / earlier.slope)
    free = ~np.array([row["collided"] for row, _ in found], dtype=np.bool_)
    used = {run_id for _, run_id in found}
    return Plans(chosen, cost, free, {one: digest for one, digest in digests.items() if one in used})


def fitted(cost: NDArray[np.float64], free: NDArray[np.bool_]) -> Fit:
    """Fit to all plans (n,); each fifth is predicted from the others to see how good such a fit is."""
    fold, predicted = np.arange(len(cost)) % FOLDS, np.empty(len(cost))
    for number in range(FOLDS):
        others = fold != number
        predicted[~others] = confidence_of_cost(
            cost[~others], fit_calibration(cost[others], free[others], PRIOR)
        )
    own = confidence_of_cost(cost, AS_IT_IS)
    return Fit(
        fit_calibration(cost, free, PRIOR),
        float(1.0 - free.mean()),
        calibration_error(predicted, free),
        calibration_error(own, free),
        float(log_losses(predicted, free, _LEAST).mean()),
        float(log_losses(own, free, _LEAST).mean()),
    )


def reliability(plans: Plans, fit: Fit) -> Figure:
    """Share of free plans over the stated confidence, before and after, in bins of equal number."""
    figure = Figure((4.5, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.plot((0, 1), (0, 1), color="0.7", linewidth=1)
    for parameters, label in ((AS_IT_IS, "the model's own"), (fit.parameters, "recalibrated")):
        confidence = confidence_of_cost(plans.cost, parameters)
        bins = np.array_split(np.argsort(confidence), min(10, len(confidence) // 10))
        stated, free = ([values[one].mean() for one in bins] for values in (confidence, plans.free))
        axes.plot(stated, free, "o-", label=label)
    axes.set(xlabel="stated confidence", ylabel="share that was free", xlim=(0, 1), ylim=(0, 1))
    axes.legend()
    return figure


# Calibration error of a site's plans above which training on them is proposed.
MISCALIBRATED = 0.05


def main(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    """Fit, print; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator recalibrate",
        description="Fit the confidence of plans to the uploaded outcomes of a site, and register that.",
        epilog="Exit codes: 0 fitted, whether in use or not; 1 failed; 2 wrong request or too few outcomes.",
    )
    parser.add_argument("--site", required=True, help="as in POST /outcomes and POST /plan")
    parser.add_argument("--model", metavar="NAME/VERSION", help="default: that of most of the site's plans")
    options = parser.parse_args(arguments)
    try:
        found = recalibrate(options.site, options.model, *stores.connect(environment))
    except CspaceError as error:
        return report_error(error, ConfigError, InputError, EvaluationError)
    version, fit = found.version, found.fit
    print(
        f"{version} of {version.tags['model']}, {found.plans} plans, {fit.collide:.1%} collide\n"
        f"calibration error {fit.error_before:.3f} before, {fit.error:.3f} after; "
        f"log loss {fit.loss_before:.3f} before, {fit.loss:.3f} after (each fifth by a fit to the rest)\n"
        + (
            "in use for requests with this site"
            if fit.better
            else "not put into use, for it predicts no better"
        )
    )
    if fit.error_before > MISCALIBRATED:
        print(
            f"the model misjudges this site; to train on its plans, if their pictures were kept:\n"
            f"  python -m training.data import-outcomes $PWD/outcomes --site {options.site} --arm ROBOT\n"
            "  ray job submit --working-dir . -- python training/cluster_train.py --preset panda_outcomes "
            "--set data.robot=ROBOT --set data.outcomes=$PWD/outcomes"
        )
    return 0


def _version(registry: ModelRegistry, text: str) -> ModelVersion:
    name, _, number = text.partition("/")
    if not number.isdecimal():
        raise RegistryError("an outcome names no calibration", expected="name/version", got=repr(text)[:200])
    return registry.version(name, int(number))
