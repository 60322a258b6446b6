"""Calibrate the plans of a version by their outcomes: ``python -m services.evaluator recalibrate``.

The confidence of plans is exp(-D'), where log D' = offset + slope log D and D is -log of what the version
stated. Both numbers are fitted to uploaded outcomes, and become the calibration of a new version, the
challenger, which the gate compares with the champion like any other.

Every plan counts once a client and problem, a client makes up at most a given share of the plans, and no
confidence is raised beyond the careful end of its interval.
"""

import argparse
import hashlib
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize

from cspace.bundle import Bundle, load_verified
from cspace.bundle.files import GOLDEN_FILE, GoldenCase
from cspace.bundle.load import graphs_of, write_bundle
from cspace.errors import ConfigError, CspaceError, EvaluationError, InputError, ModelNotFoundError
from cspace.planning.cost import confidence_of_cost, fit_calibration
from services.commands import SHARE, report_error
from services.evaluator.statistics import Interval, log_losses, mean_interval
from services.names import ALIAS_CHALLENGER, EXPERIMENT, MODEL_NAME, OUTCOMES_FILE, TAG_MODEL, TAG_STAGE
from services.outcomes import Row, log_reliability, uploaded
from services.registry import connect, tracking_uri
from services.registry.entities import ID, ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking

LEAST_PROBLEMS, LEAST_OF_EACH, FOLDS = 20, 5, 5
MOST_PER_CLIENT = 0.2
# Weaker than that of a bundle, for places may be quite unlike training.
PRIOR = 1.0
# Of what the provenance says beside the source.
FITTED_AGAIN = "plans_fitted_again"
_RESAMPLES, _LEAST = 200, 1e-6
_PRESENT = (0.0, 1.0)
# log D of everything that a plan may be stated with.
_GRID = np.linspace(np.log(_LEAST), np.log(30.0), 60)


class Plans(NamedTuple):
    """Checked plans of one version, a row each, and the digest of each uploaded batch by its run."""

    table: pd.DataFrame
    batches: Mapping[str, str]

    @property
    def columns(self) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.int_]]:
        """(n,) D of each, whether it was free, and the number of its client."""
        stated = self.table["confidence"].to_numpy(dtype=np.float64).clip(_LEAST, 1.0 - _LEAST)
        free = ~self.table["collided"].to_numpy(dtype=bool)
        return -np.log(stated), free, pd.factorize(self.table["client"], sort=True)[0]


class Predicted(NamedTuple):
    """Mean log loss of the plans by fits to others and as stated, and the paired gain."""

    loss: float
    before: float
    gain: Interval


@dataclass(frozen=True, slots=True)
class Recalibrated:
    """What :func:`recalibrate` made."""

    version: ModelVersion
    plans: int
    parameters: tuple[float, float]
    predicted: Predicted


def recalibrate(
    model: ModelReference,
    site: str | None,
    most_per_client: float,
    tracking: Tracking,
    registry: ModelRegistry,
) -> Recalibrated:
    """Fit to a version's outcomes, of a site or of all, and register, once for the same outcomes."""
    version = registry.look_up(model)
    plans = plans_of(str(version), site, most_per_client, tracking)
    parameters = careful_fit(*plans.columns)
    if parameters is None:
        raise EvaluationError(
            f"the outcomes agree with what {version} states",
            expected="a 95 % interval of the calibration without the present one",
            got=f"{len(plans.table)} plans, of which {np.mean(plans.columns[1]):.1%} were free",
            remedy="nothing is to be done, or send more outcomes",
        )
    predicted = _predicted(plans)
    note = {"model": str(version), "site": site, "most_per_client": most_per_client}
    tags = {TAG_STAGE: "recalibration", TAG_MODEL: str(version)}
    key = hashlib.sha256(f"{version.digest} {parameters} {note}".encode()).hexdigest()
    with tempfile.TemporaryDirectory(prefix="cspace-recalibrate-") as folder:
        source = load_verified(registry.download(version, Path(folder) / "source"), version.digest)
        made = _write(source, Path(folder) / "bundle", parameters, note)
        with tracking.start(
            EXPERIMENT, f"recalibrated, {ID}", version.run_id, tags, f"recalibrate/{key}"
        ) as run:
            run.params({**note, "plans": len(plans.table), "offset": parameters[0], "slope": parameters[1]})
            run.metrics({"log_loss": predicted.loss, "log_loss_before": predicted.before}, 0)
            log_reliability(run, plans.table)
            for run_id, digest in plans.batches.items():
                run.dataset("outcomes", digest, f"runs:/{run_id}/{OUTCOMES_FILE}", "calibration")
        kept = {
            name: version.tags[name] for name in ("data_digest", "preset", "seed") if name in version.tags
        }
        registered = registry.register(
            version.name, made.folder, run.run_id, made.digest, kept, alias=ALIAS_CHALLENGER
        )
    return Recalibrated(registered, len(plans.table), parameters, predicted)


def predicted_reports(bundle: Bundle, champion: Bundle, tracking: Tracking) -> Predicted | None:
    """How well a recalibrated version predicts reported plans beside the champion that it was made of.

    None for other versions. Each fifth of the plans is predicted by a fit to the others.
    """
    note = bundle.spec.provenance.config.get(FITTED_AGAIN, {})
    if not isinstance(note, dict) or note.get("source_digest") != champion.digest or "model" not in note:
        return None
    return _predicted(plans_of(note["model"], note["site"], note["most_per_client"], tracking))


def plans_of(model: str, site: str | None, most_per_client: float, tracking: Tracking) -> Plans:
    """The plans of ``name/version`` in all uploaded batches that count."""
    batches, digests = [], {}
    for run_id, digests[run_id], rows in uploaded(tracking):
        batches.append(pd.DataFrame([row.model_dump() for row in rows], columns=[*Row.model_fields]))
        batches[-1]["run_id"] = run_id
    table = pd.concat([pd.DataFrame(columns=[*Row.model_fields, "run_id"]), *batches])
    is_checked = (table["kind"] == "plan") & table["confidence"].notna() & table["collided"].notna()
    is_known = is_checked & (table["problem"] != "") & (table["model"] == model)
    known = table[is_known & (table["site"] == site if site else True)].fillna({"client": ""})
    # From the oldest on, so that what was reported last holds.
    known = known.drop_duplicates(["client", "problem"], keep="last")
    clients = known.groupby("client")
    used = clients.tail(_cap(clients.size().tolist(), most_per_client)).sort_values(["client", "problem"])
    problems, collided = used["problem"].nunique(), int(used["collided"].sum())
    if problems < LEAST_PROBLEMS or min(collided, len(used) - collided) < LEAST_OF_EACH:
        raise EvaluationError(
            f"too few outcomes of plans of {model}",
            expected=f"{LEAST_PROBLEMS} different problems, {LEAST_OF_EACH} plans that collide and "
            f"{LEAST_OF_EACH} that do not, at most {most_per_client:.0%} of one client",
            got=f"{len(known)} plans of {len(clients)} clients, of which {len(used)} may count: "
            f"{problems} problems, {collided} plans that collide",
            remedy="send and upload more outcomes; --most-per-client 1 trusts one client alone",
        )
    return Plans(used, {one: digests[one] for one in used["run_id"].unique()})


def _cap(counts: Sequence[int], share: float) -> int:
    """How many plans of each client may count so that none has more than its share of all that do."""
    fitting = (
        most
        for most in range(max(counts, default=0), 0, -1)
        if most <= share * sum(min(count, most) for count in counts) + 1e-9
    )
    return next(fitting, 0)


def careful_fit(
    cost: NDArray[np.float64], free: NDArray[np.bool_], client: NDArray[np.int_]
) -> tuple[float, float] | None:
    """(offset, slope) for plans (n,); None where their interval holds the present calibration.

    The fit is bound to lines that raise no confidence beyond the 97.5 % quantile of bootstrapped costs.
    Clients are drawn and then plans of each, so that what one client alone reports is not certain.
    """
    rng, of_each = np.random.default_rng(0), [np.flatnonzero(client == one) for one in np.unique(client)]
    drawn = np.empty((_RESAMPLES, 2))
    for number in range(_RESAMPLES):
        chosen = [of_each[one] for one in rng.integers(len(of_each), size=len(of_each))]
        pick = np.concatenate([rng.choice(plans, len(plans)) for plans in chosen])
        drawn[number] = fit_calibration(cost[pick], free[pick], PRIOR)
    # Two intervals of 97.5 % have both parameters with 95 %.
    shift = drawn @ np.array([1.0, np.median(np.log(cost))]) - np.median(np.log(cost))
    low, high = np.quantile(np.stack([shift, drawn[:, 1] - 1.0]), [0.0125, 0.9875], axis=1)
    if np.all((low <= 0.0) & (high >= 0.0)):
        return None
    careful = np.quantile(drawn[:, :1] + drawn[:, 1:] * _GRID, 0.975, axis=0)
    least = np.minimum(_GRID, careful)

    def loss(parameters: NDArray[np.float64]) -> float:
        confidence = confidence_of_cost(cost, (parameters[0], parameters[1]))
        pull = PRIOR * float(np.sum((parameters - _PRESENT) ** 2))
        return pull + float(log_losses(confidence, free, _LEAST).sum())

    bound = {"type": "ineq", "fun": lambda one: one[0] + one[1] * _GRID - least}
    found = minimize(
        loss, np.array(_PRESENT), method="SLSQP", bounds=[(-10.0, 10.0), (0.05, 10.0)], constraints=bound
    ).x
    # What the solver's tolerance leaves.
    offset = float(found[0] + max(0.0, np.max(least - found[0] - found[1] * _GRID)))
    return offset, float(found[1])


def _predicted(plans: Plans) -> Predicted:
    """The log loss of each fifth by a fit to the others, beside that of what was stated."""
    cost, free, client = plans.columns
    fold, predicted = np.arange(len(cost)) % FOLDS, np.empty(len(cost))
    for number in range(FOLDS):
        others = fold != number
        parameters = careful_fit(cost[others], free[others], client[others]) or _PRESENT
        predicted[~others] = confidence_of_cost(cost[~others], parameters)
    ours, theirs = log_losses(predicted, free, _LEAST), log_losses(np.exp(-cost), free, _LEAST)
    gain = mean_interval(theirs - ours, np.random.default_rng(0))
    return Predicted(float(ours.mean()), float(theirs.mean()), gain)


def _write(
    source: Bundle, folder: Path, parameters: tuple[float, float], note: Mapping[str, object]
) -> Bundle:
    """The networks and the golden case of a bundle with another calibration of plans."""
    spec, (offset, slope) = source.spec, parameters
    usual = spec.plan_calibration or (_PRESENT,)
    config = {**spec.provenance.config, FITTED_AGAIN: {**note, "source_digest": source.digest}}
    made = replace(
        spec,
        plan_calibration=tuple((offset + slope * a, slope * b) for a, b in usual),
        provenance=replace(spec.provenance, config=config),
    )
    golden = GoldenCase.from_npz((source.folder / GOLDEN_FILE).read_bytes())
    return Bundle.load(write_bundle(folder, made, graphs_of(source.folder), golden))


def main(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    """Parse, fit, print; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator recalibrate",
        description="Fit the confidence of plans to uploaded outcomes, and register that as the challenger.",
        epilog="Exit codes: 0 registered; 1 failed; 2 wrong request, too few outcomes, or nothing to change.",
    )
    parser.add_argument("--model", default=f"{MODEL_NAME}@champion", help="name, name@alias or name/version")
    parser.add_argument("--site", help="outcomes of this place alone")
    share = "of the plans that one client may make up (default %(default)s); 1 trusts a single client"
    parser.add_argument("--most-per-client", type=SHARE, default=MOST_PER_CLIENT, metavar="SHARE", help=share)
    options = parser.parse_args(arguments)
    try:
        model = ModelReference.parse(options.model)
        stores = connect(tracking_uri(environment))
        found = recalibrate(model, options.site, options.most_per_client, *stores)
    except CspaceError as error:
        return report_error(error, ConfigError, InputError, EvaluationError, ModelNotFoundError)
    (offset, slope), (loss, before, gain) = found.parameters, found.predicted
    sys.stdout.write(
        f"{found.version} is the challenger: {found.plans} plans, offset {offset:.3f}, slope {slope:.3f}\n"
        f"log loss {loss:.3f} instead of {before:.3f} (gain {gain:+.3f}), each fifth by a fit to the rest\n"
        f"evaluate it: python -m services.evaluator --model {found.version}\n"
    )
    return 0
