"""Closing a connection whose client still sends, without losing the answer on its way."""

import asyncio
from collections.abc import Callable


class LingeringTransport:
    """A transport whose ``close`` is another one.

    A socket that is closed with unread bytes resets the connection, and a reset takes away from the client
    what it has not read yet.

    Args:
        transport: that is written to.
        linger: called instead of its ``close``.
    """

    def __init__(self, transport: asyncio.Transport, linger: Callable[[], None]) -> None:
        self._transport = transport
        self._linger = linger

    def write(self, data: bytes) -> None:
        """Pass bytes on."""
        self._transport.write(data)

    def is_closing(self) -> bool:
        """Whether nothing more can be written."""
        return self._transport.is_closing()

    def close(self) -> None:
        """Begin to linger."""
        self._linger()
