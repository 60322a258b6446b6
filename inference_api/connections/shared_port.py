"""One port for several processes, of which each accepts connections of its own."""

import socket
from typing import Any


class SharedPort(socket.socket):
    """A port that is taken, and that each process to which it travels listens on by itself (SO_REUSEPORT).

    The kernel then shares connections out by their addresses. On one socket for all, whichever process wakes
    first takes every connection that is waiting: clients that keep theirs may all end up with one process.
    """

    @classmethod
    def taken(cls, host: str, port: int, family: socket.AddressFamily) -> "SharedPort":
        """The port, which nobody listens on yet.

        Raises:
            OSError: somebody else has it, or there is no such address.
        """
        # Whoever shares ports as well would be let in beside this; who is there already is found out so.
        with socket.create_server((host, port), family=family) as alone:
            address = alone.getsockname()
        shared = cls(family, socket.SOCK_STREAM)
        for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
            shared.setsockopt(socket.SOL_SOCKET, option, 1)
        shared.bind(address)
        return shared

    def __reduce__(self) -> tuple[Any, ...]:
        """As a listener of the process that reads it."""
        return _listening, (self.getsockname()[:2], self.family)


def _listening(address: tuple[str, int], family: socket.AddressFamily) -> socket.socket:
    return socket.create_server(address, family=family, reuse_port=True)
