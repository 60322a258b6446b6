"""Solving a planning problem with OMPL or with the project's RRT-Connect, with learned or uniform samples.

OMPL's binding can not replace a planner's state sampler. RRT and RRT* ask a sampleable goal for states, with
the goal bias as probability. So with learned samples the goal bias is 1, and learned samples, uniform samples
and the goal all come from the goal region (``cspace_client.ompl``). Metric, nearest neighbours, step, edge
checks and goal test stay OMPL's.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from cspace.errors import PlanningError
from cspace.planning.paths import NOISE_RAD, AlongPaths
from cspace.planning.rrt_connect import Growth, grow_connect, sampled_states
from cspace.query import AlternativePath
from cspace.simulator import Checker, EdgeTest, Problem
from cspace.space import JointSpace
from cspace.worlds import checker_of
from cspace_client.ompl import (
    DEFAULT_UNIFORM_SHARE,
    DrawnGoal,
    SampleMixture,
    StateAccess,
    StateDraws,
    make_state_space,
)
from services.planner.result import (
    CHECK_FACTOR,
    RRT_CONNECT,
    RRT_STAR,
    SAMPLED_CONNECT,
    Counts,
    PlannerSettings,
    PlanResult,
    Reason,
    SearchTree,
    after,
    outcome,
)

__all__ = ["DEFAULT_UNIFORM_SHARE", "solve", "solve_with_paths"]

_ANY_COST = 1e9


def solve(
    problem: Problem,
    settings: PlannerSettings,
    samples: ArrayLike | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Solve one problem; the same arguments give the same result, in any process.

    ``samples`` (n, d) rad are drawn in this order and once each, mixed with a share of uniform ones; without
    any, OMPL samples uniformly.

    Where the independent check rejects the path, because it grazes an obstacle between two checked states,
    the search begins again at the check's own resolution, with what is left of its limits. The result counts
    both searches.

    OMPL holds the interpreter's lock while it searches and keeps its random seed in the process: one solve at
    a time in a process, no threads.
    """
    learned = _fitting(problem, samples)
    checker = checker_of(problem.scenario)
    for end, reason in ((problem.start, Reason.START_COLLIDES), (problem.goal, Reason.GOAL_COLLIDES)):
        if not checker.valid(end):
            return outcome(problem, settings, None, reason, Counts())
    result = _once(problem, settings, learned, uniform_share, keep_tree)
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
    return after(result, _once(problem, finer, learned, uniform_share, keep_tree))


def _fitting(problem: Problem, samples: ArrayLike | None) -> NDArray[np.float64] | None:
    if samples is None or np.size(samples) == 0:
        return None
    rows = np.asarray(samples, dtype=np.float64)
    if rows.shape[1:] != (problem.space.dim,) or not np.all(np.isfinite(rows)):
        expected, got = f"finite values of shape (n, {problem.space.dim})", f"shape {rows.shape}"
        raise PlanningError("the samples do not fit the robot", expected=expected, got=got)
    return rows


def _once(
    problem: Problem,
    settings: PlannerSettings,
    learned: NDArray[np.float64] | None,
    uniform_share: float,
    keep_tree: bool,
) -> PlanResult:
    if settings.planner == SAMPLED_CONNECT:
        return _connect(problem, settings, learned, uniform_share, keep_tree=keep_tree)
    space = problem.space
    goal = space.wrap(problem.goal).tolist()
    draws: StateDraws = GoalOnly(goal)
    if learned is not None:
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(1,)))
        draws = SampleMixture(space, goal, learned, settings.goal_bias, uniform_share, rng)
    run = set_up(problem, settings, draws)
    rule = StoppingRule(settings)
    began = time.perf_counter()
    status = run.planner.solve(ob.PlannerTerminationCondition(rule))
    solve_time_s = time.perf_counter() - began
    found = None
    if status.getStatus() == ob.PlannerStatus.EXACT_SOLUTION:
        found = run.access.rows(run.definition.getSolutionPath().getStates())
    uniform = rule.iterations - draws.goal_drawn
    if learned is not None:
        uniform = draws.uniform_drawn
    elif settings.planner == RRT_CONNECT:
        # It roots a tree in the goal and then draws a uniform state in every iteration.
        uniform = rule.iterations
    counts = Counts(
        iterations=rule.iterations,
        edge_checks=run.edges.checks,
        state_checks=run.edges.states + run.states.checks,
        solve_time_s=solve_time_s,
        learned_drawn=draws.learned_drawn,
        uniform_drawn=uniform,
    )
    return outcome(
        problem,
        settings,
        found,
        rule.reason or Reason.NO_PATH,
        counts,
        tree=copy_tree(run) if keep_tree else None,
    )


def _connect(
    problem: Problem,
    settings: PlannerSettings,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """The project's RRT-Connect, which draws from given samples, as OMPL's can not."""
    checker = checker_of(problem.scenario)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    states, learned = sampled_states(problem.space, samples, uniform_share, settings.max_iterations, rng)
    growth = Growth(settings.range_rad, settings.resolution_rad, settings.time_limit_s)
    grown = grow_connect(checker, problem.start, problem.goal, states, growth)
    learned_drawn = int(learned[: grown.iterations].sum())
    counts = Counts(
        iterations=grown.iterations,
        edge_checks=grown.edge_checks,
        state_checks=grown.state_checks,
        solve_time_s=grown.time_s,
        learned_drawn=learned_drawn,
        uniform_drawn=grown.iterations - learned_drawn,
    )
    tree = None
    if keep_tree:
        children = np.flatnonzero(grown.parents >= 0)
        edges = np.stack([grown.parents[children], children], axis=1)
        tree = SearchTree(grown.nodes, edges.astype(np.intp))
    reason = Reason.TIME_LIMIT if grown.timed_out else Reason.ITERATION_LIMIT
    return outcome(problem, settings, grown.path, reason, counts, tree=tree)


def solve_with_paths(
    problem: Problem, settings: PlannerSettings, paths: Sequence[AlternativePath]
) -> PlanResult:
    """Solves a problem by one of the paths, or by RRT-Connect with configurations around them.

    The checks of the paths are among the result's counts.
    """
    test = checker_of(problem.scenario).edge_test(settings.resolution_rad)
    began, edges, states = time.perf_counter(), 0, 0
    for candidate in paths:
        free, looked_at, tried = _checked(test, candidate)
        edges, states = edges + tried, states + looked_at
        if free:
            counts = Counts(edge_checks=edges, state_checks=states, solve_time_s=time.perf_counter() - began)
            found = outcome(problem, settings, candidate.path, Reason.NO_PATH, counts)
            if found.solved:
                return found
    spent = Counts(edge_checks=edges, state_checks=states, solve_time_s=time.perf_counter() - began)
    tried_first = outcome(problem, settings, None, Reason.NO_PATH, spent)
    around = None
    if paths:
        rng = np.random.default_rng(settings.seed)
        along = AlongPaths([candidate.path for candidate in paths], problem.space, rng)
        around = along.take(len(NOISE_RAD) * along.turn_rows)[0]
    left_s = max(settings.time_limit_s - spent.solve_time_s, 1e-3)
    return after(
        tried_first, _connect(problem, replace(settings, time_limit_s=left_s), around, DEFAULT_UNIFORM_SHARE)
    )


def _checked(test: EdgeTest, candidate: AlternativePath) -> tuple[bool, int, int]:
    """Whether a path is free, and how many states and edges were checked for that; the least sure first."""
    looked_at = 0
    for tried, piece in enumerate(np.argsort(candidate.edges, kind="stable"), start=1):
        free, count = test(candidate.path[piece], candidate.path[piece + 1])
        looked_at += count
        if not free:
            return False, looked_at, tried
    return True, looked_at, len(candidate.edges)


class GoalOnly:
    """Gives the goal; for planners that draw uniform states themselves."""

    def __init__(self, goal: Sequence[float]) -> None:
        self.goal_drawn = self.learned_drawn = self.uniform_drawn = 0
        self._goal = goal

    def draw(self) -> Sequence[float]:
        """The goal."""
        self.goal_drawn += 1
        return self._goal

    def goal_reached(self) -> None:
        """Nothing changes: OMPL itself stops drawing the goal."""


class EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    """Checks the straight wrapped segment between two states and counts the edges and their states."""

    def __init__(self, information: Any, checker: Checker, resolution_rad: float) -> None:
        super().__init__(information)
        self.checks = self.states = 0
        self._access = StateAccess(checker.space)
        self._from, self._to = np.zeros(checker.space.dim), np.zeros(checker.space.dim)
        self._test = checker.edge_test(resolution_rad)

    def checkMotion(self, start: Any, end: Any) -> bool:  # noqa: N802 - OMPL's name
        """Whether the motion is free, both ends included."""
        self.checks += 1
        self._access.read(start, self._from)
        self._access.read(end, self._to)
        free, states = self._test(self._from, self._to)
        self.states += states
        return bool(free)


class StateValidator:
    """Checks one state and counts the checks."""

    def __init__(self, checker: Checker) -> None:
        self.checks = 0
        self._access = StateAccess(checker.space)
        self._buffer = np.zeros(checker.space.dim)
        self._checker = checker

    def __call__(self, state: Any) -> bool:
        """Whether the state is free."""
        self.checks += 1
        self._access.read(state, self._buffer)
        return self._checker.valid(self._buffer)


class TorusLength(ob.OptimizationObjective):  # type: ignore[misc]
    """Length (L2) of the straight wrapped segment between two states, rad.

    OMPL's own path length adds up the joints (L1), so that many paths of different L2 length are equal to it:
    in an open scene RRT* with it ended 8 % above the shortest path. An objective in Python costs 1 to 2 us an
    edge, four to six times an iteration of RRT* with OMPL's own.
    """

    def __init__(self, information: Any, space: JointSpace) -> None:
        super().__init__(information)
        self._circles = [joint for joint in range(space.dim) if space.periodic[joint]]
        self._intervals = [joint for joint in range(space.dim) if not space.periodic[joint]]

    def stateCost(self, state: Any) -> Any:  # noqa: N802, ARG002 - OMPL's name and argument
        """Nothing: a state has no length."""
        return ob.Cost(0.0)

    def motionCost(self, start: Any, end: Any) -> Any:  # noqa: N802
        """The segment's length."""
        total = 0.0
        for joint in self._circles:
            gap = abs(start[joint].value - end[joint].value)
            if gap > math.pi:
                gap = math.tau - gap
            total += gap * gap
        for joint in self._intervals:
            total += (start[joint][0] - end[joint][0]) ** 2
        return ob.Cost(math.sqrt(total))


@dataclass(frozen=True, slots=True)
class OmplSearch:
    """The OMPL objects of one search; none of them outlives it."""

    planner: Any
    definition: Any
    information: Any
    edges: EdgeValidator
    states: StateValidator
    access: StateAccess


class StoppingRule:
    """Asked by OMPL before each iteration: counts iterations, ends the search."""

    def __init__(self, settings: PlannerSettings) -> None:
        self.iterations = 0
        self.reason: Reason | None = None
        self._settings, self._began = settings, time.perf_counter()

    def __call__(self) -> bool:
        """Whether the search has to end now."""
        if self.reason is None:
            if self.iterations >= self._settings.max_iterations:
                self.reason = Reason.ITERATION_LIMIT
            elif time.perf_counter() - self._began >= self._settings.time_limit_s:
                self.reason = Reason.TIME_LIMIT
            else:
                self.iterations += 1
        return self.reason is not None


def set_up(problem: Problem, settings: PlannerSettings, draws: StateDraws) -> OmplSearch:
    """Everything that a search needs, seeded."""
    # OMPL calls a second seed in a process an error, yet takes it for all generators made from then on.
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(_ompl_seed(settings.seed))
    space, checker = problem.space, checker_of(problem.scenario)
    access = StateAccess(space)
    information = ob.SpaceInformation(make_state_space(space))
    edges = EdgeValidator(information, checker, settings.resolution_rad)
    states = StateValidator(checker)
    information.setStateValidityChecker(states)
    information.setMotionValidator(edges)
    information.setup()
    definition = ob.ProblemDefinition(information)
    start = information.allocState()
    access.write(start, space.wrap(problem.start).tolist())
    definition.addStartState(start)
    mixed = isinstance(draws, SampleMixture)
    goal = space.wrap(problem.goal).tolist()
    definition.setGoal(DrawnGoal(information, goal, draws, unlimited=mixed))
    if settings.planner == RRT_STAR:
        # The wrapper spares OMPL a look for Python's versions of all other methods of an objective.
        objective = ob.MultiOptimizationObjective(information)
        objective.addObjective(TorusLength(information, space), 1.0)
        if settings.stop_at_first:
            objective.setCostThreshold(ob.Cost(_ANY_COST))
        definition.setOptimizationObjective(objective)
    planner = getattr(og, settings.planner)(information)
    planner.setRange(settings.range_rad)
    if settings.planner != RRT_CONNECT:
        planner.setGoalBias(1.0 if mixed else settings.goal_bias)
    planner.setProblemDefinition(definition)
    planner.setup()
    return OmplSearch(planner, definition, information, edges, states, access)


def _ompl_seed(seed: int) -> int:
    """OMPL takes no zero, and neighbouring seeds should not be neighbours in its generator."""
    return int(np.random.SeedSequence(seed).generate_state(1)[0] % (2**31 - 1)) + 1


def copy_tree(run: OmplSearch) -> SearchTree:
    """The planner's tree as arrays that outlive it."""
    data = ob.PlannerData(run.information)
    run.planner.getPlannerData(data)
    count = data.numVertices()
    vertices = run.access.rows([data.getVertex(index).getState() for index in range(count)])
    edges = [(index, child) for index in range(count) for child in data.getEdges(index)]
    return SearchTree(vertices, np.array(edges, dtype=np.intp).reshape(-1, 2))
