"""What a planner gains: OMPL's RRT with learned samples beside the same RRT with uniform ones."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.query import SampleQuery
from cspace.simulator import Problem
from cspace.worlds import picture_of
from services.evaluator.measures.scenes import ScoredSampler
from services.evaluator.statistics import (
    CensoredSummary,
    Interval,
    censored_as_largest,
    clopper_pearson,
    ratio_of_medians_interval,
    ratio_of_sums_interval,
    summarise_censored,
)
from services.planner.ompl_planner import solve
from services.planner.planning import between_ends
from services.planner.result import PlanResult, Reason, check_path
from services.planner.samples import SampleSource
from services.planner.settings import PlannerSettings

LEARNED_SAMPLES = 300
UNIFORM_SHARE = 0.3

Solver = Callable[[Problem, PlannerSettings, NDArray[np.float32] | None, float], PlanResult]


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """One run of a planner.

    Args:
        success: a path was found and accepted.
        iterations: of the planner, until it stopped.
        edge_checks: until it stopped.
        solve_time_s: until it stopped, without the time to draw samples.
        length_rad: torus length of the accepted path, None without one.
        learned_drawn: how many learned samples the planner used.
        reason: why it stopped, in words.
    """

    success: bool
    iterations: int
    edge_checks: int
    solve_time_s: float
    length_rad: float | None
    learned_drawn: int
    reason: str


@dataclass(frozen=True, slots=True)
class PlanningTrial:
    """All runs on one problem, and the time that the learned samples took to draw.

    ``confident`` is the run with learned samples that the validity head let pass; None without a head, or
    where it lets too few pass.
    """

    family: str
    index: int
    seed: int
    uniform: RunOutcome
    learned: RunOutcome
    sampling_time_s: float
    confident: RunOutcome | None = None


def plan_trial(
    problem: Problem,
    index: int,
    seed: int,
    sampler: SampleSource,
    settings: PlannerSettings,
    solver: Solver = solve,
) -> PlanningTrial:
    """Solve one problem with each kind of samples under one seed, above 0, which replaces the planner's.

    A path model is asked with start and goal as well as the picture.
    """
    seeded = replace(settings, seed=seed)
    began = time.perf_counter()
    image = picture_of(problem.scenario)
    samples = learned_samples(problem, image, seed, sampler)
    sampling_time_s = time.perf_counter() - began
    uniform, learned, *confident = (
        _outcome(problem, solver(problem, seeded, proposals, UNIFORM_SHARE), settings.resolution_rad)
        for proposals in (None, samples, *_confident(problem, image, seed, sampler))
    )
    only = confident[0] if confident else None
    return PlanningTrial(problem.family, index, seed, uniform, learned, sampling_time_s, only)


def learned_samples(
    problem: Problem,
    image: NDArray[np.uint8],
    seed: int,
    sampler: SampleSource,
    min_confidence: float = 0.0,
) -> NDArray[np.float32]:
    """The samples (n, d) rad for a run on a problem, given its picture; n is less where too few pass.

    Raises:
        SamplerError: as the source has it.
    """
    query = SampleQuery(LEARNED_SAMPLES, seed, min_confidence=min_confidence)
    return sampler.answer(image, between_ends(query, problem) if sampler.with_ends else query).samples


def _confident(
    problem: Problem, image: NDArray[np.uint8], seed: int, sampler: SampleSource
) -> list[NDArray[np.float32]]:
    """As many learned samples that the validity head accepts; nothing where it accepts too few.

    Path models without a head are run again, other models without one are not.
    """
    if not (isinstance(sampler, ScoredSampler) or sampler.with_ends):
        return []
    least = sampler.threshold if isinstance(sampler, ScoredSampler) else 0.0
    samples = learned_samples(problem, image, seed, sampler, least)
    return [samples] if len(samples) == LEARNED_SAMPLES else []


def _outcome(problem: Problem, result: PlanResult, resolution_rad: float) -> RunOutcome:
    # Whatever the solver reports, the path is checked here.
    checked = check_path(problem, result.path, resolution_rad) if result.solved else result.reason
    success = checked == Reason.SOLVED
    return RunOutcome(
        success,
        result.iterations,
        result.edge_checks,
        result.solve_time_s,
        float(result.length_rad) if success else None,
        result.learned_drawn,
        str(checked),
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
    ours, theirs = ([run.length_rad for run in runs] for runs in (learned, uniform))
    both = pd.DataFrame({"ours": ours, "theirs": theirs}).dropna().astype(float)
    return ratio_of_sums_interval(both["ours"], both["theirs"], rng) if len(both) else None
