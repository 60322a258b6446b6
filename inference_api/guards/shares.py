"""What there is but once, shared out among clients."""

from collections import defaultdict
from typing import Literal

# A client alone gets FACTOR of FACTOR + 1 parts; the more clients there are, the less each.
FACTOR = 3

Full = Literal["server", "client"]


class Shares:
    """Places of which each client may hold at most ``FACTOR`` times as many as are free.

    The bound of dynamic queue thresholds (Choudhury and Hahne 1998): whoever takes much leaves little free,
    and thereby lowers his own bound, so some places stay for who comes next. No lock: one event loop uses it.

    Args:
        limit: places in all, at least 1.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.free = limit
        self._held: defaultdict[str, int] = defaultdict(int)

    def take(self, client: str, amount: int = 1) -> Full | None:
        """Take places, all or none; tells what is full, or None.

        Args:
            client: who takes them.
            amount: how many, at least 1.
        """
        if amount > self.free:
            return "server"
        if self._held.get(client, 0) >= FACTOR * self.free:
            return "client"
        self.free -= amount
        self._held[client] += amount
        return None

    def give(self, client: str, amount: int = 1) -> None:
        """Give places back."""
        self.free += amount
        left = self._held[client] - amount
        if left:
            self._held[client] = left
        else:
            del self._held[client]
