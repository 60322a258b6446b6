"""Requests that are computed take turns: so many at the same time in threads, the others wait."""

from collections.abc import Callable
from typing import TypeVar

from anyio import CapacityLimiter, to_thread
from prometheus_client import Gauge

Result = TypeVar("Result")


class Turns:
    """Runs work off the event loop.

    Args:
        threads: how much work is done at the same time, at least 1.
        waiting: told how many wait for their turn.
    """

    def __init__(self, threads: int, waiting: Gauge) -> None:
        self._limiter, self._waiting = CapacityLimiter(threads), waiting

    async def run(self, work: Callable[[], Result]) -> Result:
        """What the work returns or raises."""
        began = False

        def turn() -> Result:
            nonlocal began
            began = True
            self._waiting.dec()
            return work()

        self._waiting.inc()
        try:
            return await to_thread.run_sync(turn, limiter=self._limiter)
        finally:
            # A request that is cancelled before its turn never gets one.
            if not began:
                self._waiting.dec()
