"""An evaluation as flat numbers by name, for the tracking server and the gate."""

from services.evaluator.evaluation.units import Evaluation, SplitResult
from services.evaluator.measures.planning_summary import COSTS, ArmSummary, FamilySummary
from services.evaluator.measures.reconstruction import ReconstructionSummary, SamplerSummary
from services.evaluator.statistics import Interval

SAMPLERS = ("sampler", "confident", "uniform", "real")
MEASURES = ("precision", "coverage", "edr", "precision_p10", "knn_precision", "knn_recall")


def flat_metrics(evaluation: Evaluation) -> dict[str, float]:
    """All estimates with their limits by name; those of the test split start with ``test_``.

    Then comes the family of the scenarios, unless it is the uniform one, as in ``test_narrow_precision``.
    """
    metrics = _split_metrics(evaluation.validation, "") | _split_metrics(evaluation.test, "test_")
    for name, summary in evaluation.topology.items():
        metrics |= _interval_metrics(f"test_{name}", summary.score)
        metrics |= _interval_metrics(f"test_{name}_floor", summary.floor)
    if evaluation.topology_scenes:
        metrics["test_gs_remainder"] = max(scene.remainder for scene in evaluation.topology_scenes)
    return metrics | {"evaluation_cpu_seconds": evaluation.cpu_seconds}


def _split_metrics(split: SplitResult, prefix: str) -> dict[str, float]:
    metrics = {} if split.reconstruction is None else _reconstruction_metrics(split.reconstruction, prefix)
    for name, summary in split.families.items():
        metrics |= _reconstruction_metrics(summary, f"{prefix}{name}_")
    if split.planning_success is not None:
        metrics |= _interval_metrics(f"{prefix}planning_success", split.planning_success)
    for family in split.planning:
        metrics |= _family_metrics(family, f"{prefix}{family.family}_")
    return metrics


def _reconstruction_metrics(summary: ReconstructionSummary, prefix: str) -> dict[str, float]:
    metrics: dict[str, float] = {}
    for name in SAMPLERS:
        one: SamplerSummary | None = getattr(summary, name)
        if one is None:
            continue
        label = prefix if name == "sampler" else f"{prefix}{name}_"
        for metric in MEASURES:
            metrics |= _interval_metrics(label + metric, getattr(one, metric))
        metrics[f"{label}precision_minimum"] = one.precision_minimum
    metrics |= _interval_metrics(f"{prefix}precision_gain", summary.precision_gain)
    head = summary.occupancy
    for metric in () if head is None else ("accuracy", "near_accuracy", "calibration_error", "acceptance"):
        value: Interval | None = getattr(head, metric)
        metrics |= {} if value is None else _interval_metrics(f"{prefix}head_{metric}", value)
    return metrics


def _family_metrics(family: FamilySummary, prefix: str) -> dict[str, float]:
    metrics = {f"{prefix}sampling_time_s": family.sampling_time_s}
    for name in ("uniform", "learned", "confident"):
        arm: ArmSummary | None = getattr(family, name)
        if arm is None:
            continue
        metrics |= _interval_metrics(f"{prefix}{name}_success", arm.success)
        metrics[f"{prefix}{name}_censored"] = float(arm.iterations.censored)
        for cost in COSTS:
            metrics[f"{prefix}{name}_{cost}_median"] = getattr(arm, cost).median
    for ratio in (
        "iterations_ratio",
        "edge_checks_ratio",
        "solve_time_ratio",
        "length_ratio",
        "filter_ratio",
    ):
        value = getattr(family, ratio)
        metrics |= {} if value is None else _interval_metrics(f"{prefix}{ratio}", value)
    return metrics


def _interval_metrics(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.estimate, f"{name}_low": interval.low, f"{name}_high": interval.high}
