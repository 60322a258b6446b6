"""Bounds on connections."""

import logging
import resource
from dataclasses import dataclass, replace

_LOG = logging.getLogger(__name__)
# Open files beside connections: the log, the event loop, pipes to processes, models that are read.
OTHER_FILES = 64
KIB = 1024
MIB = 1024 * KIB


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """What one connection may take, and how many there may be.

    Args:
        connections: open at the same time, at least 1.
        header_timeout_s: from a request's first byte to the end of its headers, above 0; for the first
            request from the connection on.
        write_timeout_s: for an answer that the client does not read, above 0; what is unsent lengthens it.
        write_bytes_per_s: by how much.
        unread_bytes: of answers that the clients of one address leave unread for a second or longer, in all.
        header_bytes: of request line and headers together; as much again may stand beside a body, as
            trailers and chunk extensions.
        headers: of one request, trailers included.
        target_bytes: of the path with its query.
        pipelined: requests of one connection that wait for those before them.
        linger_s: after an answer to a request that was not read to its end, so that the client reads it.
        linger_bytes: that are read and thrown away in this time; above the largest body, or a client that
            reads only when it has sent everything would lose its answer.
    """

    connections: int = 512
    header_timeout_s: float = 10.0
    write_timeout_s: float = 10.0
    write_bytes_per_s: int = 64 * KIB
    unread_bytes: int = 16 * MIB
    header_bytes: int = 32 * KIB
    headers: int = 100
    target_bytes: int = 8 * KIB
    pipelined: int = 32
    linger_s: float = 1.0
    linger_bytes: int = 9 * MIB


def within_open_files(limits: ConnectionLimits) -> ConnectionLimits:
    """The limits of a process that may open only so many files; its soft limit becomes the hard one.

    Each connection is a file. Without one left nobody could connect, and idle ones would never be cut for it.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    most = limits.connections if hard == resource.RLIM_INFINITY else max(1, hard - OTHER_FILES)
    if limits.connections <= most:
        return limits
    _LOG.warning(
        "at most %d connections, not %d: the process may open %d files", most, limits.connections, hard
    )
    return replace(limits, connections=most)
