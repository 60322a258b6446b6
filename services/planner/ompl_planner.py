"""Solving a planning problem with OMPL, with learned samples or with OMPL's own uniform ones.

Without learned samples the planner is OMPL's as it stands. With them only the source of the states differs:
metric, nearest neighbours, step, edge checks and goal test are the same. Single runs of the same seed still
differ by chance, because the streams of random numbers do. PRM and SampledRRTConnect take uniform states from
this project's generator in both cases.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob

from cspace.errors import PlanningError
from cspace.simulator import Checker, Problem
from cspace.worlds import checker_of
from cspace_client.ompl import (
    DEFAULT_UNIFORM_SHARE,
    SampleMixture,
    StateAccess,
    StateDraws,
)
from services.planner.ompl_adapters import (
    CostRecord,
    EdgeValidator,
    Roadmap,
    StoppingRule,
    copy_tree,
    free_test,
    set_up,
)
from services.planner.result import CHECK_FACTOR, Counts, PlanResult, Reason, after, outcome
from services.planner.rrt_connect import connect
from services.planner.settings import (
    BIT_STAR,
    LEARNED_PLANNERS,
    OPTIMISING_PLANNERS,
    PRM,
    RRT_CONNECT,
    SAMPLED_CONNECT,
    PlannerSettings,
    check_uniform_share,
)

__all__ = ["DEFAULT_UNIFORM_SHARE", "DrawnMilestones", "solve", "solve_by_roadmap"]


class GoalOnly:
    """Gives the goal; for planners that draw uniform states themselves."""

    def __init__(self, goal: Sequence[float]) -> None:
        self.goal_drawn = self.learned_drawn = self.uniform_drawn = self.state_checks = 0
        self._goal = goal

    def draw(self) -> Sequence[float]:
        """The goal."""
        self.goal_drawn += 1
        return self._goal

    def goal_reached(self) -> None:
        """Nothing changes: OMPL itself stops drawing the goal."""


class DrawnMilestones(ob.ValidStateSampler):  # type: ignore[misc]
    """Gives a PRM its ends and then what a source draws, where that is free.

    Args:
        information: OMPL's space information.
        access: to states of the joint space.
        ends: start and goal, d values in rad each, known to be free.
        draws: the source.
        is_free: checks a state.
        limit: how many may be drawn.
    """

    def __init__(
        self,
        information: Any,
        access: StateAccess,
        ends: Sequence[Sequence[float]],
        draws: StateDraws,
        is_free: Callable[[Any], bool],
        limit: int,
    ) -> None:
        super().__init__(information)
        self._access, self._draws, self._is_free, self._limit = access, draws, is_free, limit
        self._ends = list(ends)

    def sample(self, state: Any) -> bool:
        """Write the next state; whether it is free."""
        if self._ends:
            self._access.write(state, self._ends.pop(0))
            return True
        # OMPL asks twice before it asks whether to go on.
        if sample_count(self._draws) >= self._limit:
            return False
        self._access.write(state, self._draws.draw())
        return self._is_free(state)


def sample_count(draws: StateDraws) -> int:
    """How many states a source gave."""
    return draws.goal_drawn + draws.learned_drawn + draws.uniform_drawn


def solve_by_roadmap(
    problem: Problem,
    settings: PlannerSettings,
    draws: StateDraws,
    checker: Checker,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Grow a roadmap until it joins start and goal; see :func:`services.planner.ompl_planner.solve`.

    ``PRM.solve`` looks for a solution in a second thread, which waits for the interpreter's lock while
    the search waits for it: with a termination condition in Python it never ends. So OMPL only grows the
    roadmap (``growRoadmap``: draw a free state, join it to its ten nearest milestones by free motions),
    and the condition stops it once start and goal are connected. The rounds of expansion, which depend
    on the clock, are left out. Start and goal are the first two milestones and no iterations.

    Args:
        problem: start and goal, both free.
        settings: of the planner; there is no range and no goal bias.
        draws: of the states; without a share of the goal.
        checker: of the scenario.
        keep_tree: whether the result holds the roadmap.
    """
    space = problem.space
    run = set_up(problem, settings, draws, checker, Roadmap)
    roadmap, access, is_free = run.edges, run.access, run.states
    ends = [space.wrap(end).tolist() for end in (problem.start, problem.goal)]
    # What OMPL keeps must not lead back to it: reference counts see no cycles through C++.
    run.information.setValidStateSamplerAllocator(
        lambda information: DrawnMilestones(
            information, access, ends, draws, is_free, settings.max_iterations
        )
    )
    start, goal = (roadmap.number(np.array(end)) for end in ends)
    rule = StoppingRule(
        settings.max_iterations, settings.time_limit_s, sample_count=lambda: sample_count(draws)
    )
    began, found = time.perf_counter(), None
    run.planner.growRoadmapPtc(ob.PlannerTerminationCondition(lambda: roadmap.joined(start, goal) or rule()))
    if roadmap.joined(start, goal):
        found = roadmap.shortest_path(space, start, goal)
    solve_time_s = time.perf_counter() - began
    counts = Counts(
        iterations=rule.iterations,
        edge_checks=roadmap.checks,
        state_checks=run.state_checks,
        solve_time_s=solve_time_s,
        learned_drawn=draws.learned_drawn,
        uniform_drawn=draws.uniform_drawn,
    )
    tree = copy_tree(run) if keep_tree else None
    return outcome(problem, settings, found, rule.reason or Reason.NO_PATH, counts, tree=tree)


def solve(
    problem: Problem,
    settings: PlannerSettings,
    samples: ArrayLike | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Solve one problem; the same arguments give the same result, in any process.

    Where the independent check rejects the path, for it grazes an obstacle between two states that were
    checked, the search begins again at the check's own resolution, with what is left of its limits. The
    result counts both searches.

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
    checker = checker_of(problem.scenario)
    learned = _fitting(problem, settings, samples)
    for end, reason in ((problem.start, Reason.START_COLLIDES), (problem.goal, Reason.GOAL_COLLIDES)):
        if not checker.valid(end):
            return outcome(problem, settings, None, reason, Counts())
    result = _once(problem, settings, learned, uniform_share, checker, keep_tree)
    iterations = settings.max_iterations - result.iterations
    left_s = settings.time_limit_s - result.solve_time_s
    if result.reason is not Reason.REJECTED or iterations < 1 or left_s <= 0.0:
        return result
    finer = replace(
        settings,
        resolution_rad=settings.resolution_rad / CHECK_FACTOR,
        max_iterations=iterations,
        time_limit_s=left_s,
    )
    return after(result, _once(problem, finer, learned, uniform_share, checker, keep_tree))


def _once(
    problem: Problem,
    settings: PlannerSettings,
    learned: NDArray[np.float64] | None,
    uniform_share: float,
    checker: Checker,
    keep_tree: bool,
) -> PlanResult:
    if settings.planner == SAMPLED_CONNECT:
        return connect(problem, settings, learned, uniform_share, keep_tree=keep_tree)
    draws = _draws(problem, settings, learned, uniform_share, checker)
    if settings.planner == PRM:
        return solve_by_roadmap(problem, settings, draws, checker, keep_tree=keep_tree)
    return _search(problem, settings, draws, checker, keep_tree)


def _fitting(
    problem: Problem, settings: PlannerSettings, samples: ArrayLike | None
) -> NDArray[np.float64] | None:
    dim = problem.space.dim
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
    problem: Problem,
    settings: PlannerSettings,
    learned: NDArray[np.float64] | None,
    uniform_share: float,
    checker: Checker,
) -> StateDraws:
    space = problem.space
    goal, goal_bias = space.wrap(problem.goal).tolist(), settings.goal_bias
    if settings.planner == PRM:
        # The goal is a milestone from the start, and uniform states come from here as well.
        goal_bias, learned = 0.0, np.empty((0, space.dim)) if learned is None else learned
    if learned is None:
        return GoalOnly(goal)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(1,)))
    is_free = free_test(checker) if settings.colliding_last else None
    return SampleMixture(space, goal, learned, goal_bias, uniform_share, rng, is_free)


def _search(
    problem: Problem,
    settings: PlannerSettings,
    draws: StateDraws,
    checker: Checker,
    keep_tree: bool,
) -> PlanResult:
    validator = Roadmap if keep_tree and settings.planner == BIT_STAR else EdgeValidator
    run = set_up(problem, settings, draws, checker, validator)
    rule = StoppingRule(
        settings.max_iterations,
        settings.time_limit_s,
        # BIT* draws in batches and asks before each edge. It checks what it draws, and the start.
        sample_count=(lambda: max(0, run.states.checks - 1)) if settings.planner == BIT_STAR else None,
    )
    record = None
    if settings.planner in OPTIMISING_PLANNERS:
        record = CostRecord(rule, lambda: float(run.planner.bestCost().value()), lambda: run.edges.checks)
    began = time.perf_counter()
    status = run.planner.solve(ob.PlannerTerminationCondition(record or rule))
    solve_time_s = time.perf_counter() - began
    found = None
    if status.getStatus() == ob.PlannerStatus.EXACT_SOLUTION:
        found = run.access.rows(run.definition.getSolutionPath().getStates())
    if record is not None:
        record.look()
    tree = None
    if keep_tree:
        tree = run.edges.copy() if isinstance(run.edges, Roadmap) else copy_tree(run)
    mixed = isinstance(draws, SampleMixture)
    counts = Counts(
        iterations=rule.iterations,
        edge_checks=run.edges.checks,
        state_checks=run.state_checks,
        solve_time_s=solve_time_s,
        learned_drawn=draws.learned_drawn,
        uniform_drawn=draws.uniform_drawn if mixed else _ompl_samples(settings, rule.iterations, draws),
    )
    return outcome(
        problem,
        settings,
        found,
        rule.reason or Reason.NO_PATH,
        counts,
        tree=tree,
        costs=tuple(record.points) if record is not None else (),
    )


def _ompl_samples(settings: PlannerSettings, iterations: int, draws: StateDraws) -> int:
    # RRTConnect roots a tree in the goal and then draws a uniform state in every iteration.
    return iterations if settings.planner == RRT_CONNECT else iterations - draws.goal_drawn
