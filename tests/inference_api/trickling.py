"""A registry that never comes to an end: one byte every so often, for as long as the client stays."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal

PAUSE_S = 0.2
Kind = Literal["header", "body", "silent"]
_BODY_HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 1000000\r\n\r\n"


@contextmanager
def trickling(kind: Kind = "header") -> Iterator[str]:
    """Serve until the context is left; yields the address as ``127.0.0.1:PORT``.

    Args:
        kind: a head that never ends, a body that never ends, or no word at all.
    """
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.1)

        def accept() -> None:
            while not ended.is_set():
                with suppress(TimeoutError):
                    client, _ = listener.accept()
                    threading.Thread(target=_drip, args=(client, kind, ended), daemon=True).start()

        thread = threading.Thread(target=accept)
        thread.start()
        try:
            yield f"127.0.0.1:{listener.getsockname()[1]}"
        finally:
            ended.set()
            thread.join()


def _drip(client: socket.socket, kind: Kind, ended: threading.Event) -> None:
    with client, suppress(OSError):
        if kind == "body":
            client.sendall(_BODY_HEAD)
        elif kind == "header":
            client.sendall(b"HTTP/1.1 200 OK\r\nX-Slow: ")
        while not ended.wait(PAUSE_S):
            if kind != "silent":
                client.sendall(b" ")
