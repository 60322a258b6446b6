"""What a planner gains: OMPL's RRT with learned samples against the same RRT with uniform ones.

Both solve the same problems with the same seeds. A run counts as a success when its path ends at the goal
and an independent check at ten times the resolution accepts it. A run without success is censored, never
dropped.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cspace.problem import Problem
from cspace.query import SampleQuery
from cspace.worlds import picture_of
from services.evaluator.measures.samplers import ScoredSampler
from services.planner.planning import between_ends
from services.planner.search.ompl_planner import PlannerSettings, PlanResult, Reason, solve
from services.planner.search.path_check import judge_path
from services.planner.sources.samples import SampleSource

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
    """Solve one problem with each kind of samples under one seed.

    Args:
        problem: start and goal in a scenario.
        index: the problem's number within its family.
        seed: of planner and sampler, above 0.
        sampler: draws the learned samples from the scenario's picture, and a path model from start and goal
            as well.
        settings: of the planner; its seed is replaced.
        solver: the planner.
    """
    seeded = replace(settings, seed=seed)
    began = time.perf_counter()
    image = picture_of(problem.scenario)
    samples = learned_samples(problem, image, seed, sampler)
    sampling_time_s = time.perf_counter() - began
    uniform, learned, *confident = (
        _outcome(problem, solver(problem, seeded, drawn, UNIFORM_SHARE), settings.resolution_rad)
        for drawn in (None, samples, *_confident(problem, image, seed, sampler))
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
    """As many learned samples, of those that the validity head lets pass; nothing where it lets too few.

    Of models without a head those for paths are run again, the others not.
    """
    least = sampler.threshold if isinstance(sampler, ScoredSampler) else 0.0
    if not (isinstance(sampler, ScoredSampler) or sampler.with_ends):
        return []
    samples = learned_samples(problem, image, seed, sampler, least)
    return [samples] if len(samples) == LEARNED_SAMPLES else []


def _outcome(problem: Problem, result: PlanResult, resolution_rad: float) -> RunOutcome:
    # Whatever the solver says of itself, the path is judged here.
    judged = judge_path(problem, result.path, resolution_rad) if result.solved else result.reason
    success = judged == Reason.SOLVED
    return RunOutcome(
        success,
        result.iterations,
        result.edge_checks,
        result.solve_time_s,
        float(result.length_rad) if success else None,
        result.learned_drawn,
        str(judged),
    )
