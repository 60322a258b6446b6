"""OMPL's PRM with milestones from a source of draws.

``PRM.solve`` looks for a solution in a second thread. With a termination condition in Python that thread
waits for the interpreter's lock, which OMPL holds while it searches, and the search waits for the thread: it
never ends. So OMPL only grows the roadmap here (``growRoadmap``, one thread: draw a free state, join it to
its ten nearest milestones by the motions that are free), and this module stops it as soon as start and goal
are one component. What ``PRM.solve`` does beside that, a round of expansion after each 0.2 s of growth, is
left out: it would depend on the clock.

Both arms come from here, the uniform one with a source that has no learned samples, so their counts are
comparable. An iteration is a state drawn, free or not. Start and goal are the first two milestones and no
iterations; two that see each other are joined after none.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from ompl import base as ob

from cspace.simulator import Checker, Problem
from cspace_client.ompl.sample_mixture import StateDraws
from cspace_client.ompl.state_space import StateAccess
from services.planner.plan_result import PlanResult, Reason
from services.planner.search.ompl_search import copy_tree, set_up
from services.planner.search.outcome import Counts, outcome
from services.planner.search.roadmap import Roadmap
from services.planner.search.stopping import StoppingRule
from services.planner.settings import PlannerSettings


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
        if drawn(self._draws) >= self._limit:
            return False
        self._access.write(state, self._draws.draw())
        return self._is_free(state)


def drawn(draws: StateDraws) -> int:
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
    """Grow a roadmap until it joins start and goal; see :func:`services.planner.search.ompl_planner.solve`.

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
    rule = StoppingRule(settings.max_iterations, settings.time_limit_s, drawn=lambda: drawn(draws))
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
