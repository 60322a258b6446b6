"""Tables of an evaluation as rows of text, the header first, and how they are laid out."""

from collections.abc import Sequence

from cspace.problem import UNIFORM
from services.evaluator.evaluation.comparison import Comparison
from services.evaluator.evaluation.units import Evaluation, SplitResult
from services.evaluator.measures.planning_summary import COSTS, ArmSummary, FamilySummary
from services.evaluator.measures.reconstruction import ReconstructionSummary, SamplerSummary
from services.evaluator.statistics import CensoredSummary, Interval

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
