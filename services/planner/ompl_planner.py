"""Solving a planning problem with OMPL, with learned samples or with OMPL's own uniform ones.

Without learned samples the planner is OMPL's as it stands: its own uniform state sampler, its own goal bias.
With them only the source of the states differs (see :mod:`services.planner.goal_region`): the metric, the
nearest neighbours, the step, the edge checks and the goal test are the same. Seeds are the same as well, but
the streams of random numbers are not, so single runs differ by chance as two seeds do.
"""

import time

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob

from cspace.collision import CollisionChecker
from cspace.errors import PlanningError
from cspace.problem import Problem
from services.planner.ompl_search import copy_tree, set_up
from services.planner.path_check import judge_path, path_length_rad
from services.planner.plan_result import PlanResult, Reason, SearchTree
from services.planner.sample_mixture import GoalOnly, SampleMixture, StateDraws
from services.planner.sampled_connect import connect
from services.planner.settings import (
    LEARNED_PLANNERS,
    RRT_CONNECT,
    SAMPLED_CONNECT,
    PlannerSettings,
    check_uniform_share,
)
from services.planner.stopping import StoppingRule

__all__ = ["DEFAULT_UNIFORM_SHARE", "PlanResult", "PlannerSettings", "Reason", "SearchTree", "solve"]

DEFAULT_UNIFORM_SHARE = 0.3


def solve(
    problem: Problem,
    settings: PlannerSettings,
    samples: ArrayLike | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Solve one problem; the same arguments give the same result, in any process.

    OMPL holds the interpreter's lock while it searches and keeps its random seed in the process: one solve at
    a time in a process, no threads.

    Args:
        problem: start and goal in a scenario.
        settings: of the planner.
        samples: (n, d) learned samples in rad, drawn in this order and once each; None or none of them for
            OMPL's own uniform sampling.
        uniform_share: share of uniform samples mixed in while learned ones are left, 0 to 1.
        keep_tree: whether the result holds the search tree.

    Raises:
        PlanningError: the samples or the problem do not fit the robot, or the planner takes no samples.
        ConfigError: the uniform share is out of range.
    """
    check_uniform_share(uniform_share)
    checker = CollisionChecker(problem.scenario)
    learned = _fitting(problem, settings, samples)
    for end, reason in ((problem.start, Reason.START_COLLIDES), (problem.goal, Reason.GOAL_COLLIDES)):
        if not checker.valid(end):
            return _unsolved(problem, reason)
    if settings.planner == SAMPLED_CONNECT:
        return connect(problem, settings, learned, uniform_share, keep_tree=keep_tree)
    return _search(problem, settings, _draws(problem, settings, learned, uniform_share), checker, keep_tree)


def _fitting(
    problem: Problem, settings: PlannerSettings, samples: ArrayLike | None
) -> NDArray[np.float64] | None:
    dim = problem.scenario.robot.dim
    for name, end in (("start", problem.start), ("goal", problem.goal)):
        if np.shape(end) != (dim,) or not np.all(np.isfinite(end)):
            raise PlanningError(f"the {name} does not fit the robot", expected=f"{dim} angles", got=str(end))
    if samples is None or np.size(samples) == 0:
        return None
    if settings.planner not in LEARNED_PLANNERS:
        raise PlanningError(
            f"{settings.planner} takes no learned samples", expected=" or ".join(LEARNED_PLANNERS)
        )
    rows = np.asarray(samples, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != dim or not np.all(np.isfinite(rows)):
        raise PlanningError(
            "the samples do not fit the robot",
            expected=f"finite values of shape (n, {dim})",
            got=f"shape {rows.shape}, {np.sum(~np.isfinite(rows))} not finite",
        )
    return rows


def _draws(
    problem: Problem, settings: PlannerSettings, learned: NDArray[np.float64] | None, uniform_share: float
) -> StateDraws:
    goal = problem.scenario.robot.space.wrap(problem.goal).tolist()
    if learned is None:
        return GoalOnly(goal)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(1,)))
    space = problem.scenario.robot.space
    return SampleMixture(space, goal, learned, settings.goal_bias, uniform_share, rng)


def _search(
    problem: Problem,
    settings: PlannerSettings,
    draws: StateDraws,
    checker: CollisionChecker,
    keep_tree: bool,
) -> PlanResult:
    run = set_up(problem, settings, draws, checker)
    rule = StoppingRule(settings.max_iterations, settings.time_limit_s)
    began = time.perf_counter()
    status = run.planner.solve(ob.PlannerTerminationCondition(rule))
    solve_time_s = time.perf_counter() - began
    path = np.empty((0, run.access.dim))
    reason = rule.reason or Reason.NO_PATH
    if status.getStatus() == ob.PlannerStatus.EXACT_SOLUTION:
        found = run.access.rows(run.definition.getSolutionPath().getStates())
        reason = judge_path(problem, found, settings.resolution_rad)
        path = found if reason is Reason.SOLVED else path
    path.setflags(write=False)
    mixed = isinstance(draws, SampleMixture)
    return PlanResult(
        solved=reason is Reason.SOLVED,
        path=path,
        length_rad=path_length_rad(problem, path) if len(path) else float("nan"),
        iterations=rule.iterations,
        edge_checks=run.validator.checks,
        solve_time_s=solve_time_s,
        learned_drawn=draws.learned_drawn,
        uniform_drawn=draws.uniform_drawn if mixed else _ompl_drawn(settings, rule.iterations, draws),
        reason=reason,
        tree=copy_tree(run) if keep_tree else None,
    )


def _ompl_drawn(settings: PlannerSettings, iterations: int, draws: StateDraws) -> int:
    # RRTConnect roots a tree in the goal and then draws a uniform state in every iteration.
    return iterations if settings.planner == RRT_CONNECT else iterations - draws.goal_drawn


def _unsolved(problem: Problem, reason: Reason) -> PlanResult:
    path = np.empty((0, problem.scenario.robot.dim))
    return PlanResult(
        solved=False,
        path=path,
        length_rad=float("nan"),
        iterations=0,
        edge_checks=0,
        solve_time_s=0.0,
        learned_drawn=0,
        uniform_drawn=0,
        reason=reason,
    )
