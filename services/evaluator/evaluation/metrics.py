"""What of an evaluation is told as numbers by name: all of it for programs, a chosen few for people."""

from collections.abc import Mapping, Sequence

from cspace.problem import UNIFORM
from cspace.worlds import workshop_of
from services.evaluator.evaluation.measured import (
    HEAD,
    PLANNING,
    RECONSTRUCTION,
    TOPOLOGY,
    Measured,
    measured,
)
from services.evaluator.evaluation.units import Evaluation

MAX_HEADLINE, MAX_METRICS = 12, 60

# What is told of uniform scenarios in a headline, and of every family of scenarios and problems in a run, by
# task, whose it is, and measure.
_HEADLINE = {
    (RECONSTRUCTION, "sampler", "precision"): "precision",
    (RECONSTRUCTION, "confident", "precision"): "served_precision",
    (RECONSTRUCTION, "sampler", "coverage"): "coverage",
    (RECONSTRUCTION, "confident", "coverage"): "served_coverage",
    (RECONSTRUCTION, "sampler", "edr"): "edr",
    (PLANNING, "", "planning_success"): "planning_success",
}
_OVERALL = _HEADLINE | {
    (RECONSTRUCTION, "confident", "edr"): "served_edr",
    (RECONSTRUCTION, "uniform", "precision"): "uniform_precision",
    (HEAD, "", "accuracy"): "head_accuracy",
}
_BY_FAMILY = {
    (RECONSTRUCTION, "sampler", "precision"): "precision",
    (RECONSTRUCTION, "confident", "precision"): "served_precision",
    (PLANNING, "learned", "success"): "success",
    (PLANNING, "", "iterations_ratio"): "iterations_saved",
    (PLANNING, "", "edge_checks_ratio"): "edge_checks_saved",
}


def flat_metrics(evaluation: Evaluation) -> dict[str, float]:
    """All estimates with their limits by flat name, ``_low`` and ``_high`` behind it, for programs.

    See :attr:`services.evaluator.evaluation.measured.Measured.flat_name`.
    """
    metrics: dict[str, float] = {}
    for row in measured(evaluation):
        metrics[row.flat_name] = row.value
        if row.low is not None and row.high is not None:
            metrics |= {f"{row.flat_name}_low": row.low, f"{row.flat_name}_high": row.high}
    return metrics | {"evaluation_cpu_seconds": evaluation.cpu_seconds}


def headline(evaluation: Evaluation) -> dict[str, float]:
    """What versions are chosen by, at most :data:`MAX_HEADLINE`: ``validation/precision``, ``test/...``.

    Of samplers the uniform scenarios and all problems; of path models, whose scenarios nobody measures, all
    problems and the work that is saved in the family that tells most.
    """
    rows = measured(evaluation)
    found = _named(rows, _HEADLINE)
    if evaluation.validation.reconstruction is None:
        telling = workshop_of(evaluation.setting.world).families.telling
        found |= _named_by_family([row for row in rows if row.family == telling])
    return found


def run_metrics(evaluation: Evaluation) -> dict[str, float]:
    """What an evaluation's page shows, at most :data:`MAX_METRICS`, grouped by what stands before ``/``."""
    rows = measured(evaluation)
    scores = {
        f"{row.split}/topology/{row.measure}": row.value
        for row in rows
        if row.task == TOPOLOGY and row.low is not None and not row.measure.endswith("_floor")
    }
    found = _named(rows, _OVERALL) | _named_by_family(rows) | scores
    return found | {"cost/cpu_s": evaluation.cpu_seconds}


def _named(rows: Sequence[Measured], names: Mapping[tuple[str, str, str], str]) -> dict[str, float]:
    return {
        f"{row.split}/{names[key]}": row.value
        for row in rows
        if (key := (row.task, row.sampler, row.measure)) in names
        and row.family == ("" if row.task == PLANNING else UNIFORM)
    }


def _named_by_family(rows: Sequence[Measured]) -> dict[str, float]:
    return {
        f"{row.split}/{row.family}/{_BY_FAMILY[key]}": row.value
        for row in rows
        if (key := (row.task, row.sampler, row.measure)) in _BY_FAMILY
        and row.family not in (("",) if row.task == PLANNING else ("", UNIFORM))
    }
