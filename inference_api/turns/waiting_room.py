"""Where requests wait for the registry: so many threads of its own and no more, shared out by client."""

from collections.abc import Callable
from typing import TypeVar

from anyio import CapacityLimiter, to_thread

from inference_api.guards.concurrency import full_detail
from inference_api.guards.shares import Shares
from inference_api.problems import OVERLOADED, RequestError

Result = TypeVar("Result")
SEATS = 16


class WaitingRoom:
    """Runs what may take long and computes nothing.

    Args:
        seats: how much waits at the same time, at least 1; more is refused.
    """

    def __init__(self, seats: int = SEATS) -> None:
        self._shares = Shares(seats)
        self._limiter = CapacityLimiter(seats)

    async def run(self, wait: Callable[[], Result], client: str = "") -> Result:
        """What the call returns or raises, in a thread; one that is cancelled is left to its own end.

        Raises:
            RequestError: the room, or the client's share of it, is full.
        """
        full = self._shares.take(client)
        if full is not None:
            raise RequestError(
                OVERLOADED,
                full_detail(full, "requests that wait for models", self._shares.limit),
                remedy="ask again in some seconds, or for a model that is loaded",
            )
        try:
            return await to_thread.run_sync(wait, limiter=self._limiter, abandon_on_cancel=True)
        finally:
            self._shares.give(client)
