"""Everything that an evaluation measured, one row per estimate, and the tables and metrics made of it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from cspace.simulator import UNIFORM
from cspace.worlds import simulator_of
from services.evaluator.evaluation.gate import Comparison
from services.evaluator.evaluation.units import Evaluation, SplitResult
from services.evaluator.measures.planning import COSTS, ArmSummary, FamilySummary
from services.evaluator.measures.reconstruction import ReconstructionSummary, SamplerSummary
from services.evaluator.statistics import CensoredSummary, Interval

SAMPLERS = ("sampler", "confident", "uniform", "real")
MEASURES = ("precision", "coverage", "edr", "precision_p10", "knn_precision", "knn_recall")
HEAD_MEASURES = ("accuracy", "near_accuracy", "calibration_error", "acceptance")
RATIOS = ("iterations_ratio", "edge_checks_ratio", "solve_time_ratio", "length_ratio", "filter_ratio")
ARMS = ("uniform", "learned", "confident")
VALIDATION, TEST = "validation", "test"
RECONSTRUCTION, HEAD, PLANNING, TOPOLOGY = "reconstruction", "head", "planning", "topology"


@dataclass(frozen=True, slots=True)
class Measured:
    """One estimate of an evaluation.

    Args:
        task: ``reconstruction``, ``head``, ``planning`` or ``topology``.
        split: ``validation`` or ``test``.
        family: of scenarios or problems; empty where it is of all.
        sampler: whose: ``sampler`` as drawn, ``confident`` as served, ``uniform``, ``real``; of planning
            ``learned`` instead of ``sampler``; empty for what compares two, and for the head.
        measure: its name.
        value: the estimate.
        low: its lower limit; None without an interval.
        high: the upper one.
        n: scenarios or problems behind it; None where it is of all rows at once.
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
        """By which a table tells it from all others, as ``validation uniform confident precision``."""
        return " ".join(filter(None, (self.split, self.family, self.sampler, self.task, self.measure)))

    def __str__(self) -> str:
        limits = "" if self.low is None or self.high is None else f" [{self.low:.4f}, {self.high:.4f}]"
        return f"{self.value:.4f}{limits}"

    @property
    def flat_name(self) -> str:
        """By which the gate, programs and runs of earlier releases know it.

        ``test_`` before those of the test split, then the family unless it is the uniform one of scenarios,
        then whose it is unless it is the sampler's, as in ``test_narrow_confident_precision``.
        """
        split = "" if self.split == VALIDATION else f"{self.split}_"
        usual = not self.family or (self.family == UNIFORM and self.task != PLANNING)
        family = "" if usual else f"{self.family}_"
        sampler = "" if self.sampler in ("", "sampler") else f"{self.sampler}_"
        head = "head_" if self.task == HEAD else ""
        return f"{split}{family}{sampler}{head}{self.measure}"


def measured(evaluation: Evaluation) -> tuple[Measured, ...]:
    """All estimates, validation first."""
    rows = [*_split_rows(evaluation.validation, VALIDATION), *_split_rows(evaluation.test, TEST)]
    for name, summary in evaluation.topology.items():
        rows.append(_interval(TOPOLOGY, TEST, "", "", name, summary.score))
        rows.append(_interval(TOPOLOGY, TEST, "", "", f"{name}_floor", summary.floor))
    if evaluation.topology_scenes:
        remainder = max(scene.remainder for scene in evaluation.topology_scenes)
        rows.append(Measured(TOPOLOGY, TEST, "", "", "gs_remainder", remainder))
    return tuple(rows)


def _split_rows(split: SplitResult, name: str) -> Iterator[Measured]:
    if split.reconstruction is not None:
        yield from _reconstruction_rows(split.reconstruction, name, UNIFORM)
    for family, summary in split.families.items():
        yield from _reconstruction_rows(summary, name, family)
    if split.planning_success is not None:
        yield _interval(PLANNING, name, "", "", "planning_success", split.planning_success)
    for found in split.planning:
        yield from _planning_rows(found, name)


def _reconstruction_rows(summary: ReconstructionSummary, split: str, family: str) -> Iterator[Measured]:
    for name in SAMPLERS:
        one: SamplerSummary | None = getattr(summary, name)
        if one is not None:
            place = (RECONSTRUCTION, split, family, name)
            yield from (_interval(*place, measure, getattr(one, measure)) for measure in MEASURES)
            yield Measured(*place, "precision_minimum", one.precision_minimum, n=one.precision.count)
    yield _interval(RECONSTRUCTION, split, family, "", "precision_gain", summary.precision_gain)
    for measure in () if summary.occupancy is None else HEAD_MEASURES:
        value: Interval | None = getattr(summary.occupancy, measure)
        if value is not None:
            yield _interval(HEAD, split, family, "", measure, value)


def _planning_rows(found: FamilySummary, split: str) -> Iterator[Measured]:
    family = found.family
    yield Measured(PLANNING, split, family, "", "sampling_time_s", found.sampling_time_s)
    for name in ARMS:
        arm: ArmSummary | None = getattr(found, name)
        if arm is None:
            continue
        place = (PLANNING, split, family, name)
        yield _interval(*place, "success", arm.success)
        count = arm.iterations.count
        yield Measured(*place, "censored", float(arm.iterations.censored), n=count)
        for cost in COSTS:
            yield Measured(*place, f"{cost}_median", getattr(arm, cost).median, n=count)
    for ratio in RATIOS:
        value: Interval | None = getattr(found, ratio)
        if value is not None:
            yield _interval(PLANNING, split, family, "", ratio, value)


def _interval(task: str, split: str, family: str, sampler: str, measure: str, one: Interval) -> Measured:
    return Measured(task, split, family, sampler, measure, one.estimate, one.low, one.high, one.count)


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
        telling = simulator_of(evaluation.setting.world).families.telling
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


Table = Sequence[Sequence[str]]

TITLES = ("precision", "coverage", "EDr", "k-NN precision", "k-NN recall")


def reconstruction_table(split: SplitResult) -> Table:
    """Sampler, uniform and real samples, one row each; empty for path models."""
    if split.reconstruction is None:
        return []
    rows = [["samples", *TITLES, "precision p10", "precision min"]]
    for name, one in _samplers(split.reconstruction):
        low = (f"{one.precision_p10:.3f}", f"{one.precision_minimum:.3f}")
        rows.append([name, *_measures(one), *low])
    return rows


def scene_family_table(split: SplitResult) -> Table:
    """The same by family of scenarios; empty where only the uniform ones were measured."""
    if not split.families:
        return []
    rows = [["family", "scenarios", "samples", *TITLES]]
    for family, summary in _by_family(split):
        count = str(summary.sampler.precision.count)
        rows += [[family, count, name, *_measures(one)] for name, one in _samplers(summary)]
    return rows


def occupancy_table(split: SplitResult, near_contact_m: float) -> Table:
    """The validity head by family: how often right, how honest, what it lets pass; empty without one."""
    near_contact = f"within {near_contact_m} m of contact"
    rows = [["family", "accuracy", near_contact, "calibration error", "accepted"]]
    for family, summary in _by_family(split):
        head = summary.occupancy
        if head is None:
            return []
        near = "-" if head.near_accuracy is None else f"{head.near_accuracy:.3f}"
        cells = (f"{head.accuracy:.4f}", near, f"{head.calibration_error:.4f}", f"{head.acceptance:.3f}")
        rows.append([family, *cells])
    return rows if len(rows) > 1 else []


def planning_table(families: Sequence[FamilySummary]) -> Table:
    """Per family the success rates, medians and what the learned samples save."""
    rows = [["family", "samples", "success", "iterations", "edge checks", "time [ms]", "censored"]]
    for family in families:
        arms = {"uniform": family.uniform, "learned": family.learned, "confident": family.confident}
        present = {name: arm for name, arm in arms.items() if arm is not None}
        rows += [[family.family, name, *_arm_cells(arm)] for name, arm in present.items()]
        saved = (family.iterations_ratio, family.edge_checks_ratio, family.solve_time_ratio)
        rows.append([family.family, "saved factor", "", *(f"{ratio:.2f}" for ratio in saved), ""])
        if family.filter_ratio is not None:
            rows.append([family.family, "filter factor", "", f"{family.filter_ratio:.2f}", "", "", ""])
    return rows


def comparison_table(comparison: Comparison) -> Table:
    """Every gated measure of the version beside a rival's, and what is gained."""
    words = {(True, False): "better", (False, True): "worse", (False, False): "within the interval"}
    rows = [["measure", "version", "rival", "gain", ""]]
    for one in comparison.gains:
        cells = (f"{one.ours:.4f}", f"{one.theirs:.4f}", f"{one.gain:+.4f}", words[one.better, one.worse])
        rows.append([one.name, *cells])
    return rows


def topology_table(evaluation: Evaluation) -> Table:
    """Every score beside its floor, times 1e4."""
    rows = [["score x 1e4", "sampler", "noise floor", "scenarios"]]
    for name, summary in evaluation.topology.items():
        cells = [_scaled(interval, 1e4) for interval in (summary.score, summary.floor)]
        rows.append([name, *cells, str(summary.score.count)])
    return rows


def markdown(table: Table) -> str:
    """A table in Markdown."""
    header, *rows = ["| " + " | ".join(row) + " |" for row in table]
    return "\n".join([header, "|" + " --- |" * len(table[0]), *rows])


def aligned(table: Table) -> str:
    """A table for terminals: columns as wide as their widest cell."""
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    return "\n".join(line.rstrip() for line in lines)


def _by_family(split: SplitResult) -> list[tuple[str, ReconstructionSummary]]:
    others = [(family, summary) for family, summary in split.families.items()]
    uniform = [] if split.reconstruction is None else [(UNIFORM, split.reconstruction)]
    return [*uniform, *others]


def _samplers(summary: ReconstructionSummary) -> list[tuple[str, SamplerSummary]]:
    rows = (
        ("sampler", summary.sampler),
        ("confident", summary.confident),
        ("uniform", summary.uniform),
        ("real", summary.real),
    )
    return [(name, one) for name, one in rows if one is not None]


def _measures(one: SamplerSummary) -> list[str]:
    intervals = (one.precision, one.coverage, one.edr, one.knn_precision, one.knn_recall)
    return [f"{interval:.3f}" for interval in intervals]


def _arm_cells(arm: ArmSummary) -> list[str]:
    scales = {"iterations": 1.0, "edge_checks": 1.0, "solve_time_s": 1e3}
    costs = [_quantiles(getattr(arm, cost), scales[cost]) for cost in COSTS]
    return [f"{arm.success:.2f}", *costs, f"{arm.iterations.censored} of {arm.iterations.count}"]


def _quantiles(summary: CensoredSummary, scale: float) -> str:
    """Median and 90th percentile, each with > where it is only a lower bound."""
    median, p90 = (
        f"{'>' if bound else ''}{value * scale:.4g}"
        for value, bound in ((summary.median, summary.median_is_bound), (summary.p90, summary.p90_is_bound))
    )
    return f"{median} ({p90})"


def _scaled(interval: Interval, factor: float) -> str:
    return f"{interval.estimate * factor:.2f} [{interval.low * factor:.2f}, {interval.high * factor:.2f}]"
