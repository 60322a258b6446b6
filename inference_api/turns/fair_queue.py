"""Who is next: start-time fair queueing (Goyal, Vin, Cheng 1996), so that no client's many hold another's up.

Each piece of work is given a start on a virtual clock: where the clock stands, or where what its client asked
for before ends, whichever is later. The earliest start is next. A client that asks for much is far ahead of
the clock, and one that asks for its first piece is next.
"""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")
MAX_CLIENTS = 4096


class FairQueue(Generic[Item]):
    """Items that wait, by client; for one thread, but for :meth:`charge`.

    Args:
        capacity: how many clients are remembered at least while they are ahead of the clock.
    """

    def __init__(self, capacity: int = MAX_CLIENTS) -> None:
        self._capacity = capacity
        self._clock = 0.0
        self._ends: dict[str, float] = {}
        # Not accounted for yet. To wake the other thread for each would cost more than what it tells.
        self._charges: deque[tuple[str, float]] = deque()
        self._waiting: list[tuple[float, Item]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def begin(self, client: str, cost: float) -> None:
        """Account for work that need not wait.

        Args:
            client: whose it is.
            cost: of any unit, 0 or more.
        """
        self._clock = self._start(client, cost)

    def push(self, client: str, cost: float, item: Item, lead: float = 0.0) -> None:
        """Let an item wait.

        Args:
            client: whose it is.
            cost: of any unit, 0 or more.
            item: that waits.
            lead: how far before its start it may be next. Its client pays for it all the same, so that its
                many with a lead are together as far before the others as one of them.
        """
        self._waiting.append((self._start(client, cost) - lead, item))

    def charge(self, client: str, cost: float) -> None:
        """Account for what begun work costs beyond what was told; what comes later waits longer.

        From any thread.
        """
        self._charges.append((client, cost))

    def pop(self, fits: Callable[[Item], bool]) -> Item | None:
        """The next item among those that fit, None without one; the first come of equal starts."""
        found = [(start, place) for place, (start, item) in enumerate(self._waiting) if fits(item)]
        if not found:
            return None
        start, place = min(found)
        self._clock = max(self._clock, start)
        return self._waiting.pop(place)[1]

    def discard(self, item: Item) -> bool:
        """Take an item out; whether it was there."""
        before = len(self._waiting)
        self._waiting = [entry for entry in self._waiting if entry[1] is not item]
        return len(self._waiting) < before

    def _start(self, client: str, cost: float) -> float:
        while self._charges:
            self._extend(*self._charges.popleft())
        if len(self._ends) > self._capacity:
            self._ends = {name: end for name, end in self._ends.items() if end > self._clock}
        return self._extend(client, cost)

    def _extend(self, client: str, cost: float) -> float:
        start = max(self._clock, self._ends.get(client, 0.0))
        self._ends[client] = start + cost
        return start
