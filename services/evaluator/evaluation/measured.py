"""Everything that an evaluation measured, one row an estimate; what is told of it is chosen from these."""

from collections.abc import Iterator
from dataclasses import dataclass

from cspace.problem import UNIFORM
from services.evaluator.evaluation.units import Evaluation, SplitResult
from services.evaluator.measures.planning_summary import COSTS, ArmSummary, FamilySummary
from services.evaluator.measures.reconstruction import ReconstructionSummary, SamplerSummary
from services.evaluator.statistics import Interval

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
