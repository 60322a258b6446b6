"""Planning trials over problems: success with exact limits, medians with censored runs, paired ratios."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from services.evaluator.measures.planning import PlanningTrial, RunOutcome
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    censored_as_largest,
    clopper_pearson,
    ratio_of_medians_interval,
    ratio_of_sums_interval,
    summarise_censored,
)

COSTS = ("iterations", "edge_checks", "solve_time_s")


@dataclass(frozen=True, slots=True)
class ArmSummary:
    """One kind of samples over all problems of a family; a run without success is censored."""

    success: Interval
    iterations: CensoredSummary
    edge_checks: CensoredSummary
    solve_time_s: CensoredSummary


@dataclass(frozen=True, slots=True)
class FamilySummary:
    """Learned against uniform samples over one family.

    Args:
        family: of problems.
        uniform: the baseline.
        learned: the sampler under test.
        iterations_ratio: median of uniform over median of learned; above 1 the learned samples save work.
        edge_checks_ratio: likewise.
        solve_time_ratio: likewise, without the time to draw samples.
        sampling_time_s: median time to draw the learned samples.
        length_ratio: summed path length of learned over uniform, where both succeeded; None where none did.
        confident: the sampler's samples that its validity head let pass; None without a head.
        filter_ratio: median iterations of learned over those of confident; below 1 the filter costs work.
    """

    family: str
    uniform: ArmSummary
    learned: ArmSummary
    iterations_ratio: Interval
    edge_checks_ratio: Interval
    solve_time_ratio: Interval
    sampling_time_s: float
    length_ratio: Interval | None
    confident: ArmSummary | None = None
    filter_ratio: Interval | None = None


def summarise_family(family: str, trials: Sequence[PlanningTrial], rng: np.random.Generator) -> FamilySummary:
    """Summary of the trials of one family.

    Raises:
        EvaluationError: the family has no trials.
    """
    mine = [trial for trial in trials if trial.family == family]
    if not mine:
        raise EvaluationError("a family has no planning trials", got=str(family))
    uniform, learned = [trial.uniform for trial in mine], [trial.learned for trial in mine]
    iterations, edge_checks, solve_time = (_ratio(uniform, learned, cost, rng) for cost in COSTS)
    return FamilySummary(
        family,
        _arm(uniform),
        _arm(learned),
        iterations,
        edge_checks,
        solve_time,
        float(np.median([trial.sampling_time_s for trial in mine])),
        _length_ratio(uniform, learned, rng),
        *_filtered(mine, rng),
    )


def _filtered(
    trials: Sequence[PlanningTrial], rng: np.random.Generator
) -> tuple[ArmSummary | None, Interval | None]:
    confident = [trial.confident for trial in trials if trial.confident is not None]
    if len(confident) < len(trials):
        return None, None
    learned = [trial.learned for trial in trials]
    return _arm(confident), _ratio(learned, confident, "iterations", rng)


def success_rate(trials: Sequence[PlanningTrial]) -> Interval:
    """Success of the learned samples over all trials, whatever their family."""
    return clopper_pearson(sum(trial.learned.success for trial in trials), len(trials))


def _arm(runs: Sequence[RunOutcome]) -> ArmSummary:
    failed = [not run.success for run in runs]
    costs = [summarise_censored([getattr(run, cost) for run in runs], failed) for cost in COSTS]
    return ArmSummary(clopper_pearson(len(runs) - sum(failed), len(runs)), *costs)


def _ratio(
    uniform: Sequence[RunOutcome], learned: Sequence[RunOutcome], cost: str, rng: np.random.Generator
) -> Interval:
    # Both arms share the largest value, so that a failure weighs the same on either side.
    runs = [*uniform, *learned]
    ranked = censored_as_largest([getattr(run, cost) for run in runs], [not run.success for run in runs])
    # A direct connection takes no iteration to speak of; one unit keeps the ratio finite.
    least = 1.0 if cost != "solve_time_s" else 1e-6
    first, second = np.split(np.maximum(ranked, least), 2)
    return ratio_of_medians_interval(first, second, rng)


def _length_ratio(
    uniform: Sequence[RunOutcome], learned: Sequence[RunOutcome], rng: np.random.Generator
) -> Interval | None:
    pairs: NDArray[np.float64] = np.array(
        [
            (theirs.length_rad, ours.length_rad)
            for theirs, ours in zip(uniform, learned, strict=True)
            if theirs.length_rad is not None and ours.length_rad is not None
        ],
        dtype=np.float64,
    ).reshape(-1, 2)
    return ratio_of_sums_interval(pairs[:, 1], pairs[:, 0], rng) if len(pairs) else None
