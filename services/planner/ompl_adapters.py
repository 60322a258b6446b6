"""What OMPL calls in a search: collision checks, the objective, the stopping rule and the record of costs."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from cspace.simulator import Checker, Problem
from cspace.space import JointSpace
from cspace_client.ompl import DrawnGoal, SampleMixture, StateAccess, StateDraws, make_state_space
from services.planner.result import CostPoint, Reason, SearchTree
from services.planner.settings import (
    BIT_STAR,
    INFORMED_RRT_STAR,
    OPTIMISING_PLANNERS,
    PRM,
    RRT_CONNECT,
    RRT_STAR,
    PlannerSettings,
)


class EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    """Checks the straight wrapped segment between two states and counts the checks, and the states in them.

    Args:
        information: OMPL's space information.
        checker: of the scenario.
        resolution_rad: largest distance between checked states in any joint.
    """

    def __init__(self, information: Any, checker: Checker, resolution_rad: float) -> None:
        super().__init__(information)
        space = checker.space
        self.checks = self.states = 0
        self._access = StateAccess(space)
        self._from, self._to = np.zeros(space.dim), np.zeros(space.dim)
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
    """Checks one state and counts the checks.

    Args:
        checker: of the scenario.
    """

    def __init__(self, checker: Checker) -> None:
        self.checks = 0
        self._access = StateAccess(checker.space)
        self._buffer = np.zeros(checker.space.dim)
        self._test = checker.state_test()

    def __call__(self, state: Any) -> bool:
        """Whether the state is free."""
        self.checks += 1
        self._access.read(state, self._buffer)
        return self._test(self._buffer)


def free_test(checker: Checker) -> Callable[[Sequence[float]], bool]:
    """A check of configurations of d values in rad, as plain numbers instead of OMPL's states."""
    buffer, test = np.zeros(checker.space.dim), checker.state_test()

    def is_free(configuration: Sequence[float]) -> bool:
        buffer[:] = configuration
        return test(buffer)

    return is_free


class Roadmap(EdgeValidator):
    """Checks motions and keeps those that are free.

    Args:
        information: OMPL's space information.
        checker: of the scenario.
        resolution_rad: largest distance between checked states in any joint.
    """

    def __init__(self, information: Any, checker: Checker, resolution_rad: float) -> None:
        super().__init__(information, checker, resolution_rad)
        # Milestones by the bits of their angles, as OMPL copies these; equal ones are one here.
        self._numbers: dict[bytes, int] = {}
        self._connected = DisjointSet()
        self._edges: list[tuple[int, int]] = []

    def checkMotion(self, start: Any, end: Any) -> bool:  # noqa: N802 - OMPL's name
        """Whether the motion is free, both ends included."""
        free = super().checkMotion(start, end)
        if free:
            first, second = self.number(self._from), self.number(self._to)
            if first != second:
                self._edges.append((first, second))
                self._connected.merge(first, second)
        return free

    def number(self, milestone: NDArray[np.float64]) -> int:
        """The number of a milestone (d,) rad, a new one if it is new."""
        number = self._numbers.setdefault(milestone.tobytes(), len(self._numbers))
        self._connected.add(number)
        return number

    def joined(self, first: int, second: int) -> bool:
        """Whether edges lead from one milestone to another."""
        return bool(self._connected.connected(first, second))

    def shortest_path(self, space: JointSpace, first: int, second: int) -> NDArray[np.float64]:
        """The shortest way (torus length, L2) between two joined milestones, (k, d) rad."""
        rows = self._rows()
        # Twice the same pair would count twice in the sparse matrix.
        edges = np.unique(np.sort(np.array(self._edges, dtype=np.intp), axis=1), axis=0)
        lengths = space.distance(rows[edges[:, 0]], rows[edges[:, 1]])
        graph = csr_array((lengths, edges.T), shape=(len(rows), len(rows)))
        _, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
        numbers = [second]
        while numbers[-1] != first:
            numbers.append(int(before[numbers[-1]]))
        return rows[numbers[::-1]].copy()

    def copy(self) -> SearchTree:
        """All states and all free motions."""
        return SearchTree(self._rows().copy(), np.array(self._edges, dtype=np.intp).reshape(-1, 2))

    def _rows(self) -> NDArray[np.float64]:
        return np.frombuffer(b"".join(self._numbers), dtype=np.float64).reshape(-1, len(self._from))


ANY_COST = 1e9


class TorusLength(ob.OptimizationObjective):  # type: ignore[misc]
    """Length (L2) of the straight wrapped segment between two states, rad.

    OMPL's own path length adds up the joints (L1), so that many shortest paths of different L2 length
    are equal to it: in an open scene RRT* with it ended 8 % above the shortest path. OMPL's binding has
    no L2 metric on a torus, so nearest neighbours and ranges stay L1. An objective in Python costs 1 to
    2 microseconds for each weighed edge, four to six times an iteration of RRT* with OMPL's own. It is
    also the only way to give InformedRRT* and BIT* an estimate to search by: they refuse OMPL's path
    length on a product of circles.

    Args:
        information: OMPL's space information.
        space: the joint space.
    """

    def __init__(self, information: Any, space: JointSpace) -> None:
        super().__init__(information)
        self._circles = [joint for joint in range(space.dim) if space.periodic[joint]]
        self._intervals = [joint for joint in range(space.dim) if not space.periodic[joint]]

    def length_rad(self, start: Any, end: Any) -> float:
        """Torus distance (L2) of two states."""
        total = 0.0
        for joint in self._circles:
            gap = abs(start[joint].value - end[joint].value)
            if gap > math.pi:
                gap = math.tau - gap
            total += gap * gap
        for joint in self._intervals:
            total += (start[joint][0] - end[joint][0]) ** 2
        return math.sqrt(total)

    def stateCost(self, state: Any) -> Any:  # noqa: N802, ARG002 - OMPL's name and argument
        """Nothing: a state has no length."""
        return ob.Cost(0.0)

    def motionCost(self, start: Any, end: Any) -> Any:  # noqa: N802
        """The segment's length."""
        return ob.Cost(self.length_rad(start, end))

    def motionCostHeuristic(self, start: Any, end: Any) -> Any:  # noqa: N802
        """The same: no way is shorter than the straight one."""
        return ob.Cost(self.length_rad(start, end))


class TorusLengthByGoal(TorusLength):
    """The same for InformedRRT*, whose estimate of a state goes on to the goal.

    Its sampler rejects states by the estimate from the start plus the cost to go. The binding has no way to
    set a cost to go, and the sampler is the only one that asks for the estimate, so both go into that.

    Args:
        information: OMPL's space information.
        space: the joint space.
        goal: d values in rad.
    """

    def __init__(self, information: Any, space: JointSpace, goal: Sequence[float]) -> None:
        super().__init__(information, space)
        self._goal = [(g,) if not wraps else _Angle(g) for g, wraps in zip(goal, space.periodic, strict=True)]

    def motionCostHeuristic(self, start: Any, end: Any) -> Any:  # noqa: N802
        """Lower bound of a path from the start through a state to the goal."""
        return ob.Cost(self.length_rad(start, end) + self.length_rad(end, self._goal))


class _Angle:
    """A value as OMPL's circles hold it."""

    __slots__ = ("value",)

    def __init__(self, value: float) -> None:
        self.value = value


def make_objective(
    information: Any, space: JointSpace, goal: Sequence[float], planner: str, *, stop_at_first: bool
) -> Any:
    """The objective of an optimising planner.

    Args:
        information: OMPL's space information.
        space: the joint space.
        goal: d values in rad.
        planner: one of ``OPTIMISING_PLANNERS``.
        stop_at_first: whether every path is short enough.
    """
    objective: Any
    if planner == INFORMED_RRT_STAR:
        objective = TorusLengthByGoal(information, space, goal)
    else:
        objective = TorusLength(information, space)
    if planner == RRT_STAR:
        # It needs no estimates, and the wrapper spares it a look for Python's versions of all the rest.
        objective, length = ob.MultiOptimizationObjective(information), objective
        objective.addObjective(length, 1.0)
    if stop_at_first:
        objective.setCostThreshold(ob.Cost(ANY_COST))
    return objective


class StoppingRule:
    """Asked by the planner before each iteration; counts the iterations that it allowed.

    Args:
        max_iterations: how many are allowed.
        time_limit_s: for how long, from the first question on.
        clock: the time in s.
        sample_count: how many states were sampled so far, for planners that do not ask for each; an iteration
            is a sampled state then, and not a question.
    """

    def __init__(
        self,
        max_iterations: int,
        time_limit_s: float,
        clock: Callable[[], float] = time.perf_counter,
        sample_count: Callable[[], int] | None = None,
    ) -> None:
        self.reason: Reason | None = None
        self._max_iterations = max_iterations
        self._time_limit_s = time_limit_s
        self._clock, self._sample_count = clock, sample_count
        self._allowed = 0
        self._began: float | None = None

    @property
    def iterations(self) -> int:
        """States drawn, or about to be."""
        return self._allowed if self._sample_count is None else self._sample_count()

    def __call__(self) -> bool:
        """Whether the search has to end now."""
        if self.reason is not None:
            return True
        now = self._clock()
        if self._began is None:
            self._began = now
        if self.iterations >= self._max_iterations:
            self.reason = Reason.ITERATION_LIMIT
        elif now - self._began >= self._time_limit_s:
            self.reason = Reason.TIME_LIMIT
        else:
            self._allowed += 1
        return self.reason is not None


class CostRecord:
    """Asked by the planner before each iteration, in place of the stopping rule that it asks in turn.

    OMPL's binding tells no Python function of a new solution, so the best cost is read in every iteration.

    Args:
        rule: says when the search ends.
        best_cost: the length of the best path so far, rad; not finite before there is one.
        edge_checks: motions checked so far.
        clock: the time in s.
    """

    def __init__(
        self,
        rule: StoppingRule,
        best_cost: Callable[[], float],
        edge_checks: Callable[[], int],
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.points: list[CostPoint] = []
        self._rule, self._best_cost, self._edge_checks = rule, best_cost, edge_checks
        self._clock, self._began = clock, clock()
        self._best = math.inf

    def __call__(self) -> bool:
        """Whether the search has to end now."""
        self.look()
        return self._rule()

    def look(self) -> None:
        """Note the best path if it is a new one; once more after a search, which may end with one."""
        cost = self._best_cost()
        if cost < self._best:
            self._best = cost
            elapsed_s = self._clock() - self._began
            self.points.append(CostPoint(self._rule.iterations, self._edge_checks(), elapsed_s, cost))


Edges = TypeVar("Edges", bound=EdgeValidator)


@dataclass(frozen=True, slots=True)
class OmplSearch(Generic[Edges]):
    """The OMPL objects of one search; none of them outlives it."""

    planner: Any
    definition: Any
    information: Any
    edges: Edges
    states: StateValidator
    access: StateAccess
    draws: StateDraws

    @property
    def state_checks(self) -> int:
        """States that were looked at so far, within motions and alone."""
        return self.edges.states + self.states.checks + self.draws.state_checks


def set_up(
    problem: Problem,
    settings: PlannerSettings,
    draws: StateDraws,
    checker: Checker,
    make_validator: Callable[[Any, Checker, float], Edges],
) -> OmplSearch[Edges]:
    """Everything that a search needs, seeded.

    Args:
        problem: start and goal in a scenario.
        settings: of the planner.
        draws: where the goal takes its states from; a mixture replaces OMPL's uniform sampler altogether.
        checker: of the scenario.
        make_validator: of OMPL's space information, the checker and the resolution.
    """
    # OMPL calls a second seed in a process an error, yet takes it for all generators made from then on.
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(_ompl_seed(settings.seed))
    space = problem.space
    access = StateAccess(space)
    information = ob.SpaceInformation(make_state_space(space))
    edges = make_validator(information, checker, settings.resolution_rad)
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
    if settings.planner in OPTIMISING_PLANNERS:
        definition.setOptimizationObjective(
            make_objective(information, space, goal, settings.planner, stop_at_first=settings.stop_at_first)
        )
    planner = _make_planner(information, definition, settings, 1.0 if mixed else settings.goal_bias)
    return OmplSearch(planner, definition, information, edges, states, access, draws)


def _make_planner(information: Any, definition: Any, settings: PlannerSettings, goal_bias: float) -> Any:
    planner = getattr(og, settings.planner)(information)
    if settings.planner not in (PRM, BIT_STAR):
        planner.setRange(settings.range_rad)
    if settings.planner not in (PRM, BIT_STAR, RRT_CONNECT):
        planner.setGoalBias(goal_bias)
    planner.setProblemDefinition(definition)
    planner.setup()
    return planner


def _ompl_seed(seed: int) -> int:
    """OMPL takes no zero, and neighbouring seeds should not be neighbours in its generator."""
    return int(np.random.SeedSequence(seed).generate_state(1)[0] % (2**31 - 1)) + 1


def copy_tree(run: OmplSearch[Edges]) -> SearchTree:
    """The planner's tree as arrays that outlive it.

    Not for BIT*, which never gives its memory back once it was asked for its tree (12 kB a search).
    """
    data = ob.PlannerData(run.information)
    run.planner.getPlannerData(data)
    count = data.numVertices()
    vertices = run.access.rows([data.getVertex(index).getState() for index in range(count)])
    edges = [(index, child) for index in range(count) for child in data.getEdges(index)]
    return SearchTree(vertices, np.array(edges, dtype=np.intp).reshape(-1, 2))
