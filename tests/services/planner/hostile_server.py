"""A TCP server that reads a request and then plays whatever a script has it do."""

import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from tests.fakes.sample_server import npy

Script = Callable[[socket.socket], None]
Wrap = Callable[[socket.socket], socket.socket]

SEED = 7
"""That every good answer is for."""
N = 2
"""Samples that every good answer holds."""
GOOD = np.array([[0.5, -1.0], [3.0, 1.0]], np.float32)
GOOD_BODY = npy(GOOD)
GOOD_HEADERS = {
    "Content-Type": "application/x-npy",
    "X-Model-Name": "cspace-sampler",
    "X-Model-Version": "3",
    "X-Model-Digest": "ab" * 32,
    "X-Seed": str(SEED),
    "X-Shortfall": "0",
}
# A script that never ends by itself ends with its server, and no later than this.
_PATIENCE_S = 20.0


def head(status: str = "200 OK", **changes: str | None) -> bytes:
    """A good answer's head without its last line; a header that is None is left out."""
    headers = {**GOOD_HEADERS, **{name.replace("_", "-"): value for name, value in changes.items()}}
    lines = [f"{name}: {value}" for name, value in headers.items() if value is not None]
    return "\r\n".join([f"HTTP/1.1 {status}", *lines, ""]).encode("latin-1")


def whole(body: bytes = GOOD_BODY, status: str = "200 OK", **changes: str | None) -> bytes:
    """A good answer but for its changes."""
    return head(status, **{"Content_Length": str(len(body)), **changes}) + b"\r\n" + body


def plays(content: bytes) -> Script:
    """Send, and keep the connection."""
    return lambda link: link.sendall(content)


def ends(content: bytes) -> Script:
    """Send, and close the connection."""

    def script(link: socket.socket) -> None:
        link.sendall(content)
        link.shutdown(socket.SHUT_RDWR)

    return script


def repeats(first: bytes, piece: bytes, pause_s: float = 0.0) -> Script:
    """Send a piece again and again until the other side goes away."""

    def script(link: socket.socket) -> None:
        link.sendall(first)
        until = time.monotonic() + _PATIENCE_S
        while time.monotonic() < until:
            link.sendall(piece)
            if pause_s:
                time.sleep(pause_s)

    return script


class HostileServer:
    """Plays one script for every request.

    Args:
        script: what it does to a connection after a request.
        reads: whether it reads requests, whose heads it keeps.
        wrap: what it does with a connection first.
    """

    def __init__(self, script: Script, *, reads: bool = True, wrap: Wrap = lambda link: link) -> None:
        self.script, self.reads, self.wrap = script, reads, wrap
        self.connections = 0
        self.heads: list[bytes] = []
        self._links: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=64)
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def close(self) -> None:
        # A blocked accept is not woken by close alone.
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._threads[0].join()
        for link in self._links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        for thread in self._threads[1:]:
            thread.join()

    def _accept(self) -> None:
        while True:
            try:
                link, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            self._links.append(link)
            thread = threading.Thread(target=self._serve, args=(link,))
            self._threads.append(thread)
            thread.start()

    def _serve(self, link: socket.socket) -> None:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with link, suppress(OSError, EOFError), self.wrap(link) as wrapped:
            while self.reads:
                self.heads.append(read_request(wrapped))
                self.script(wrapped)
            self.script(wrapped)


def read_request(link: socket.socket) -> bytes:
    """Read a request whole; its head.

    Raises:
        EOFError: the other side has gone.
    """
    first = b""
    while b"\r\n\r\n" not in first:
        first += _received(link)
    first, _, body = first.partition(b"\r\n\r\n")
    length = re.search(rb"(?i)content-length: (\d+)", first)
    assert length is not None
    missing = int(length[1]) - len(body)
    while missing > 0:
        missing -= len(_received(link))
    return first


def _received(link: socket.socket) -> bytes:
    if not (piece := link.recv(65536)):
        raise EOFError
    return piece


@contextmanager
def hostile_server(script: Script, **options: Any) -> Iterator[HostileServer]:
    """A server on a free loopback port, ended with all its connections; options as the class has them."""
    server = HostileServer(script, **options)
    try:
        yield server
    finally:
        server.close()
