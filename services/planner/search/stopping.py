"""When a search ends: a count of iterations, and a clock."""

import time
from collections.abc import Callable

from services.planner.plan_result import Reason


class StoppingRule:
    """Asked by the planner before each iteration; counts the iterations that it allowed.

    Args:
        max_iterations: how many are allowed.
        time_limit_s: for how long, from the first question on.
        clock: the time in s.
        drawn: how many states were drawn so far, for planners that do not ask once for each; an iteration is
            a drawn state then, and not a question.
    """

    def __init__(
        self,
        max_iterations: int,
        time_limit_s: float,
        clock: Callable[[], float] = time.perf_counter,
        drawn: Callable[[], int] | None = None,
    ) -> None:
        self.reason: Reason | None = None
        self._max_iterations = max_iterations
        self._time_limit_s = time_limit_s
        self._clock, self._drawn = clock, drawn
        self._allowed = 0
        self._began: float | None = None

    @property
    def iterations(self) -> int:
        """States drawn, or about to be."""
        return self._allowed if self._drawn is None else self._drawn()

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
