"""All open connections: how many there may be, whose turn it is to go, and one clock for all deadlines."""

import asyncio
from collections import defaultdict
from typing import TYPE_CHECKING, Protocol

from inference_api.connections.limits import ConnectionLimits

if TYPE_CHECKING:
    from prometheus_client import Gauge

SWEEP_S = 0.25


class Connection(Protocol):
    """One connection, as the table sees it."""

    address: str
    waiting_since: float

    @property
    def busy(self) -> bool:
        """Whether an answer is being made for it."""

    def look(self, now: float) -> None:
        """End what is overdue; ``now`` in s, of the loop's clock."""

    def unread_bytes(self, now: float) -> int:
        """What its client has left unread for a while."""

    def cut(self) -> None:
        """Close it, whatever is unsent."""


class ConnectionTable:
    """The connections of one process; used by its event loop alone.

    Args:
        limits: of connections.
        gauge: of open ones.
    """

    def __init__(self, limits: ConnectionLimits, gauge: "Gauge") -> None:
        self._limits = limits
        self._gauge = gauge
        self._open: dict[str, set[Connection]] = defaultdict(set)
        self._count = 0
        self._sweep: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return self._count

    def add(self, connection: Connection, loop: asyncio.AbstractEventLoop) -> None:
        """Take a new one in; where that is one too many, cut another, or this one where all others work."""
        self._open[connection.address].add(connection)
        self._count += 1
        self._gauge.inc()
        if self._count > self._limits.connections:
            self._dispensable(connection).cut()
        if self._sweep is None:
            self._sweep = loop.call_later(SWEEP_S, self._look, loop)

    def remove(self, connection: Connection) -> None:
        """Let one go; twice does not matter."""
        of_address = self._open.get(connection.address)
        if of_address is None or connection not in of_address:
            return
        of_address.remove(connection)
        if not of_address:
            del self._open[connection.address]
        self._count -= 1
        self._gauge.dec()

    def _dispensable(self, new: Connection) -> Connection:
        """The one that has waited longest, of the address that has most: none shuts others out."""
        for of_address in sorted(self._open.values(), key=len, reverse=True):
            waiting = [one for one in of_address if one is not new and not one.busy]
            if waiting:
                return min(waiting, key=lambda one: one.waiting_since)
        return new

    def _cut_unread(self, of_address: list[Connection], now: float) -> None:
        """Close what is not read, the most first, until the rest is within bounds."""
        unread = {connection: connection.unread_bytes(now) for connection in of_address}
        left = sum(unread.values())
        for connection in sorted(unread, key=lambda one: unread[one], reverse=True):
            if left <= self._limits.unread_bytes:
                return
            left -= unread[connection]
            connection.cut()

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        now = loop.time()
        for of_address in [list(connections) for connections in self._open.values()]:
            for connection in of_address:
                connection.look(now)
            self._cut_unread(of_address, now)
        self._sweep = loop.call_later(SWEEP_S, self._look, loop) if self._count else None
