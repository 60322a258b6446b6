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
    """

    def __init__(
        self, max_iterations: int, time_limit_s: float, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.iterations = 0
        self.reason: Reason | None = None
        self._max_iterations = max_iterations
        self._time_limit_s = time_limit_s
        self._clock = clock
        self._began: float | None = None

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
            self.iterations += 1
        return self.reason is not None
