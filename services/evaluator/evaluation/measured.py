"""All estimates of an evaluation in one long table, and the metrics and tables that are made of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

from cspace.simulator import UNIFORM
from cspace.worlds import simulator_of
from services.evaluator.evaluation.gate import Comparison
from services.evaluator.evaluation.units import Evaluation, SplitResult
from services.evaluator.measures.occupancy import OccupancySummary
from services.evaluator.measures.planning import COSTS, ArmSummary, FamilySummary
from services.evaluator.measures.sample_quality import ReconstructionSummary, SamplerSummary
from services.evaluator.statistics import CensoredSummary, Interval
from services.evaluator.tables import Table

VALIDATION, TEST = "validation", "test"
RECONSTRUCTION, HEAD, PLANNING, TOPOLOGY = "reconstruction", "head", "planning", "topology"
MAX_HEADLINE, MAX_METRICS = 12, 60


@dataclass(frozen=True, slots=True)
class Measured:
    """One estimate of an evaluation.

    Args:
        task: ``reconstruction``, ``head``, ``planning`` or ``topology``.
        split: ``validation`` or ``test``.
        family: of scenarios or problems; empty for all of them.
        sampler: ``sampler`` as drawn (of planning ``learned``), ``confident`` as served, ``uniform``,
            ``real``; empty for comparisons of two samplers and for the head.
        measure: its name.
        value: the estimate.
        low: its lower 95 % limit; None without an interval.
        high: its upper 95 % limit; None without an interval.
        n: number of scenarios or problems; None where it is unknown.
    """

    task: str
    split: str
    family: str
    sampler: str
    measure: str
    value: float
    low: float | None = None
    high: float | None = None
    n: int | None = None

    @property
    def title(self) -> str:
        """The unique name of the estimate, as ``validation uniform confident reconstruction precision``."""
        return " ".join(filter(None, (self.split, self.family, self.sampler, self.task, self.measure)))

    def __str__(self) -> str:
        limits = "" if self.low is None or self.high is None else f" [{self.low:.4f}, {self.high:.4f}]"
        return f"{self.value:.4f}{limits}"

    @property
    def flat_name(self) -> str:
        """The name for the gate and for programs, as ``test_narrow_confident_precision``.

        ``validation``, the uniform scenarios and the unfiltered sampler are left out of the name.
        """
        usual = self.family == UNIFORM and self.task != PLANNING
        parts = (
            "" if self.split == VALIDATION else self.split,
            "" if usual else self.family,
            "" if self.sampler == "sampler" else self.sampler,
            "head" if self.task == HEAD else "",
            self.measure,
        )
        return "_".join(filter(None, parts))


def measured(evaluation: Evaluation) -> tuple[Measured, ...]:
    """All estimates, validation first."""
    rows: list[Measured] = []
    for name, split in ((VALIDATION, evaluation.validation), (TEST, evaluation.test)):
        for family, summary in _scene_families(split):
            rows += _rows((RECONSTRUCTION, name, family, ""), summary)
        # The success over all problems.
        rows += _rows((PLANNING, name, "", ""), split)
        for found in split.planning:
            rows += _rows((PLANNING, name, found.family, ""), found)
    place = (TOPOLOGY, TEST, "", "")
    for name, score in evaluation.topology.items():
        rows += [_interval(place, name, score.score), _interval(place, f"{name}_floor", score.floor)]
    if evaluation.topology_scenes:
        remainder = max(scene.remainder for scene in evaluation.topology_scenes)
        rows.append(Measured(*place, "gs_remainder", remainder))
    return tuple(rows)


def _rows(place: tuple[str, str, str, str], summary: Any, n: int | None = None) -> Iterator[Measured]:
    """The estimates among the fields of a summary, and of the summaries in it.

    Args:
        place: task, split, family and sampler.
        summary: a dataclass.
        n: of estimates without an interval.
    """
    for name in (field.name for field in fields(summary)):
        value, inner = getattr(summary, name), (*place[:3], name)
        if isinstance(value, Interval):
            yield _interval(place, name, value)
        elif isinstance(value, CensoredSummary):
            yield Measured(*place, f"{name}_median", value.median, n=value.count)
        elif isinstance(value, float):
            yield Measured(*place, name, value, n=n)
        elif isinstance(value, SamplerSummary):
            yield from _rows(inner, value, value.precision.count)
        elif isinstance(value, ArmSummary):
            yield from _rows(inner, value)
            yield Measured(*inner, "censored", float(value.iterations.censored), n=value.iterations.count)
        elif isinstance(value, OccupancySummary):
            yield from _rows((HEAD, *place[1:]), value)


def _interval(place: tuple[str, str, str, str], measure: str, one: Interval) -> Measured:
    return Measured(*place, measure, one.estimate, one.low, one.high, one.count)


# Names of metrics by task, sampler and measure: over uniform scenarios and all problems, then of each family.
_OVERALL = {
    (RECONSTRUCTION, "sampler", "precision"): "precision",
    (RECONSTRUCTION, "confident", "precision"): "served_precision",
    (RECONSTRUCTION, "sampler", "coverage"): "coverage",
    (RECONSTRUCTION, "confident", "coverage"): "served_coverage",
    (RECONSTRUCTION, "sampler", "edr"): "edr",
    (PLANNING, "", "planning_success"): "planning_success",
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
_HEADLINE = tuple(_OVERALL.values())[:6]


def flat_metrics(evaluation: Evaluation) -> dict[str, float]:
    """All estimates by flat name, with their limits under ``NAME_low`` and ``NAME_high``."""
    metrics: dict[str, float] = {}
    for row in measured(evaluation):
        metrics[row.flat_name] = row.value
        if row.low is not None and row.high is not None:
            metrics |= {f"{row.flat_name}_low": row.low, f"{row.flat_name}_high": row.high}
    return metrics | {"evaluation_cpu_seconds": evaluation.cpu_seconds}


def headline(evaluation: Evaluation) -> dict[str, float]:
    """At most :data:`MAX_HEADLINE` metrics by which versions are chosen, as ``validation/precision``.

    Path models, which have none over scenarios, add those of the family that tells most.
    """
    paths = evaluation.validation.reconstruction is None
    decisive = simulator_of(evaluation.setting.world).families.decisive
    return {
        name: value
        for name, value in run_metrics(evaluation).items()
        if name.partition("/")[2] in _HEADLINE or (paths and name.split("/")[1] == decisive)
    }


def run_metrics(evaluation: Evaluation) -> dict[str, float]:
    """At most :data:`MAX_METRICS` metrics for an evaluation's page, grouped by the part before ``/``."""
    metrics = {}
    for row in measured(evaluation):
        overall = row.family == ("" if row.task == PLANNING else UNIFORM)
        names, group = (_OVERALL, row.split) if overall else (_BY_FAMILY, f"{row.split}/{row.family}")
        name = names.get((row.task, row.sampler, row.measure))
        if name is not None:
            metrics[f"{group}/{name}"] = row.value
    scores = {f"{TEST}/topology/{name}": one.score.estimate for name, one in evaluation.topology.items()}
    return metrics | scores | {"cost/cpu_s": evaluation.cpu_seconds}


TITLES = ("precision", "coverage", "EDr", "k-NN precision", "k-NN recall")
SAMPLERS, ARMS = ("sampler", "confident", "uniform", "real"), ("uniform", "learned", "confident")


def reconstruction_table(split: SplitResult) -> Table:
    """One row for each kind of samples on uniform scenarios; empty for path models."""
    if split.reconstruction is None:
        return []
    rows = [["samples", *TITLES, "precision p10", "precision min"]]
    for name, one in _present(split.reconstruction, SAMPLERS):
        rows.append([name, *_cells(one), f"{one.precision_p10:.3f}", f"{one.precision_minimum:.3f}"])
    return rows


def scene_family_table(split: SplitResult) -> Table:
    """The same by family of scenarios; empty where only the uniform ones were measured."""
    rows = [["family", "scenarios", "samples", *TITLES]]
    for family, summary in _scene_families(split) if split.families else ():
        count = str(summary.sampler.precision.count)
        rows += [[family, count, name, *_cells(one)] for name, one in _present(summary, SAMPLERS)]
    return rows if len(rows) > 1 else []


def occupancy_table(split: SplitResult, near_contact_m: float) -> Table:
    """Accuracy, calibration and acceptance of the validity head by family; empty without a head."""
    rows = [["family", "accuracy", f"within {near_contact_m} m of contact", "calibration error", "accepted"]]
    for family, summary in _scene_families(split):
        head = summary.occupancy
        if head is None:
            return []
        near = "-" if head.near_accuracy is None else f"{head.near_accuracy:.3f}"
        cells = (f"{head.accuracy:.4f}", near, f"{head.calibration_error:.4f}", f"{head.acceptance:.3f}")
        rows.append([family, *cells])
    return rows if len(rows) > 1 else []


def planning_table(families: Sequence[FamilySummary]) -> Table:
    """Success rates, medians and saved factors of each family."""
    rows = [["family", "samples", "success", "iterations", "edge checks", "time [ms]", "censored"]]
    for one in families:
        for name, arm in _present(one, ARMS):
            costs = [_quantiles(getattr(arm, cost), 1e3 if cost == "solve_time_s" else 1.0) for cost in COSTS]
            censored = f"{arm.iterations.censored} of {arm.iterations.count}"
            rows.append([one.family, name, f"{arm.success:.2f}", *costs, censored])
        saved = (one.iterations_ratio, one.edge_checks_ratio, one.solve_time_ratio)
        rows.append([one.family, "saved factor", "", *(f"{ratio:.2f}" for ratio in saved), ""])
        if one.filter_ratio is not None:
            rows.append([one.family, "filter factor", "", f"{one.filter_ratio:.2f}", "", "", ""])
    return rows


def comparison_table(comparison: Comparison) -> Table:
    """Every gated measure of the version and of a rival, and the gain."""
    words = {(True, False): "better", (False, True): "worse", (False, False): "within the interval"}
    rows = [["measure", "version", "rival", "gain", ""]]
    for one in comparison.gains:
        cells = (f"{one.ours:.4f}", f"{one.theirs:.4f}", f"{one.gain:+.4f}", words[one.better, one.worse])
        rows.append([one.name, *cells])
    return rows


def topology_table(evaluation: Evaluation) -> Table:
    """Every score and its floor, times 1e4."""
    rows = [["score x 1e4", "sampler", "noise floor", "scenarios"]]
    for name, one in evaluation.topology.items():
        cells = [f"{interval.scaled(1e4):.2f}" for interval in (one.score, one.floor)]
        rows.append([name, *cells, str(one.score.count)])
    return rows


def _scene_families(split: SplitResult) -> list[tuple[str, ReconstructionSummary]]:
    uniform = [] if split.reconstruction is None else [(UNIFORM, split.reconstruction)]
    return [*uniform, *split.families.items()]


def _present(summary: object, names: Sequence[str]) -> list[tuple[str, Any]]:
    return [(name, one) for name in names if (one := getattr(summary, name)) is not None]


def _cells(one: SamplerSummary) -> list[str]:
    return [f"{x:.3f}" for x in (one.precision, one.coverage, one.edr, one.knn_precision, one.knn_recall)]


def _quantiles(summary: CensoredSummary, scale: float) -> str:
    """Median and 90th percentile; > marks a lower bound."""
    values = ((summary.median, summary.median_is_bound), (summary.p90, summary.p90_is_bound))
    return "{} ({})".format(*(f"{'>' if bound else ''}{value * scale:.4g}" for value, bound in values))
