"""How the best path's length falls while an optimising planner goes on."""

import math
import time
from collections.abc import Callable

from services.planner.plan_result import CostPoint
from services.planner.search.stopping import StoppingRule


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
