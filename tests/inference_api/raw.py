"""Plain sockets to a server, for what no client library would send, and what its process holds."""

import re
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from urllib.parse import urlsplit

import httpx

PATIENCE_S = 20.0
LOOK_S = 0.05


def connect(address: str, source: str | None = None) -> socket.socket:
    """A connection; from another loopback address where one is named."""
    target = urlsplit(address)
    assert target.hostname
    assert target.port
    origin = None if source is None else (source, 0)
    return socket.create_connection((target.hostname, target.port), PATIENCE_S, origin)


def head(method: str, path: str, *headers: str) -> bytes:
    """A request's head with its empty line."""
    return "\r\n".join((f"{method} {path} HTTP/1.1", "Host: localhost", *headers, "", "")).encode()


def everything(link: socket.socket) -> bytes:
    """What comes until the server closes."""
    answer = b""
    with suppress(ConnectionError):
        while chunk := link.recv(65536):
            answer += chunk
    return answer


def one_answer(link: socket.socket) -> bytes:
    """One answer with its body; what there is of it where the server closes first."""
    answer = b""
    while chunk := link.recv(65536):
        answer += chunk
        start, found, body = answer.partition(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", start.lower())
        if found and length and len(body) >= int(length[1]):
            break
    return answer


def until(holds: Callable[[], bool], patience_s: float = PATIENCE_S) -> float:
    """Wait for something to hold; how long it took, in s."""
    began = time.monotonic()
    while not holds():
        assert time.monotonic() - began < patience_s, "it did not come to hold"
        time.sleep(LOOK_S)
    return time.monotonic() - began


def metric(address: str, name: str, headers: dict[str, str] | None = None) -> float:
    """The value of a metric without labels."""
    text = httpx.get(f"{address}/metrics", headers=headers, timeout=30).text
    found = re.search(rf"^{name} (\S+)$", text, re.MULTILINE)
    assert found, text
    return float(found[1])
