"""A registry that never comes to an end, a byte every so often as long as the client stays; or that dies."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal

PAUSE_S = 0.2
Kind = Literal["header", "body", "silent", "cut"]
_BODY_HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 1000000\r\n\r\n"


@contextmanager
def trickling(kind: Kind = "header") -> Iterator[str]:
    """Serve until the context is left; yields the address as ``127.0.0.1:PORT``.

    Args:
        kind: a head that never ends, a body that never ends, no word at all, or a body that is cut short.
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
        if kind in ("body", "cut"):
            client.sendall(_BODY_HEAD)
        elif kind == "header":
            client.sendall(b"HTTP/1.1 200 OK\r\nX-Slow: ")
        while kind != "cut" and not ended.wait(PAUSE_S):
            if kind != "silent":
                client.sendall(b" ")
