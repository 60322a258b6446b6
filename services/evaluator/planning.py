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

from cspace.collision import CollisionChecker
from cspace.problem import Family, Problem
from cspace.render import render
from services.evaluator.samplers import Sampler
from services.planner.ompl_planner import PlannerSettings, PlanResult, solve

GOAL_TOLERANCE_RAD = 1e-6
CHECK_FACTOR = 10.0
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
    """Both runs on one problem, and the time that the learned samples took to draw."""

    family: Family
    index: int
    seed: int
    uniform: RunOutcome
    learned: RunOutcome
    sampling_time_s: float


def plan_trial(
    problem: Problem,
    index: int,
    seed: int,
    sampler: Sampler,
    settings: PlannerSettings,
    solver: Solver = solve,
) -> PlanningTrial:
    """Solve one problem with uniform and with learned samples under one seed.

    Args:
        problem: start and goal in a scenario.
        index: the problem's number within its family.
        seed: of planner and sampler, above 0.
        sampler: draws the learned samples from the scenario's picture.
        settings: of the planner; its seed is replaced.
        solver: the planner.
    """
    seeded = replace(settings, seed=seed)
    began = time.perf_counter()
    samples = sampler.sample(render(problem.scenario), LEARNED_SAMPLES, seed)
    sampling_time_s = time.perf_counter() - began
    results = [solver(problem, seeded, drawn, UNIFORM_SHARE) for drawn in (None, samples)]
    uniform, learned = (_outcome(problem, result, settings.resolution_rad) for result in results)
    return PlanningTrial(problem.family, index, seed, uniform, learned, sampling_time_s)


def accepted(problem: Problem, path: NDArray[np.float64], resolution_rad: float) -> bool:
    """Whether a path (k, d) leads from start to goal and every edge is free at ten times the resolution."""
    if len(path) < 2:
        return False
    space = problem.scenario.robot.space
    ends = space.distance(path[[0, -1]], np.stack([problem.start, problem.goal]))
    if not (ends <= GOAL_TOLERANCE_RAD).all():
        return False
    checker = CollisionChecker(problem.scenario)
    return bool(checker.edge_batch(path[:-1], path[1:], resolution_rad / CHECK_FACTOR).all())


def _outcome(problem: Problem, result: PlanResult, resolution_rad: float) -> RunOutcome:
    success = result.solved and accepted(problem, result.path, resolution_rad)
    reason = "the independent check rejected the path" if result.solved and not success else result.reason
    return RunOutcome(
        success,
        result.iterations,
        result.edge_checks,
        result.solve_time_s,
        float(result.length_rad) if success else None,
        result.learned_drawn,
        reason,
    )
