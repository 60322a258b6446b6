"""A registry that dies on command: a proxy of real sockets before a real server."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit

TRIGGER = b"/artifacts/"
BLOCK = 4096
ACCEPT_S = 0.2


class CuttingProxy:
    """Passes connections on, until it is armed and an answer with an artifact has begun.

    Then it cuts the answer after so many of its bytes, and takes no further connection until it is mended:
    what a client sees of a server that is killed in the middle of a download.

    Args:
        target: address of the server, as ``http://127.0.0.1:PORT``.
    """

    def __init__(self, target: str) -> None:
        parts = urlsplit(target)
        self._target = (str(parts.hostname), int(parts.port or 0))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(ACCEPT_S)
        self._ended = threading.Event()
        self._left: int | None = None
        self._lock = threading.Lock()
        self.cut = threading.Event()

    @property
    def address(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def cut_after(self, count: int) -> None:
        """Die after so many bytes of answers that carry artifacts."""
        with self._lock:
            self._left = count

    def mend(self) -> None:
        """Serve again."""
        with self._lock:
            self._left = None
            self.cut.clear()

    @contextmanager
    def running(self) -> Iterator["CuttingProxy"]:
        """Listens until the context is left."""
        thread = threading.Thread(target=self._serve, daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self._ended.set()
            thread.join()
            self._listener.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            with suppress(TimeoutError):
                client, _ = self._listener.accept()
                if self.cut.is_set():
                    client.close()
                else:
                    threading.Thread(target=self._pass_on, args=(client,), daemon=True).start()

    def _pass_on(self, client: socket.socket) -> None:
        with suppress(OSError), client, socket.create_connection(self._target) as server:
            asks_artifact = threading.Event()
            upstream = threading.Thread(
                target=self._upward, args=(client, server, asks_artifact), daemon=True
            )
            upstream.start()
            while block := server.recv(BLOCK):
                client.sendall(block if not asks_artifact.is_set() else self._allowed(block))
                if self.cut.is_set():
                    break
            # Wakes the thread that still reads.
            client.shutdown(socket.SHUT_RDWR)

    def _upward(self, client: socket.socket, server: socket.socket, asks_artifact: threading.Event) -> None:
        with suppress(OSError):
            while block := client.recv(BLOCK):
                first = block.split(b"\r\n", 1)[0]
                # A connection is kept for the next question, which may be about something else.
                if first.endswith(b" HTTP/1.1"):
                    (asks_artifact.set if TRIGGER in first else asks_artifact.clear)()
                server.sendall(block)
            server.shutdown(socket.SHUT_RDWR)

    def _allowed(self, block: bytes) -> bytes:
        with self._lock:
            if self._left is None:
                return block
            allowed, self._left = block[: self._left], max(0, self._left - len(block))
            if self._left == 0:
                self.cut.set()
            return allowed
