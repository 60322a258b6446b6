"""httpx's transport over the network with one deadline for a whole request.

The time limits of httpx hold for each read and write, and a server that sends a byte at a time stays below
them for ever. Here every operation on the socket is given no more time than the deadline leaves. Everything
else (HTTP, kept connections, TLS) is httpcore's, as in ``httpx.HTTPTransport``.
"""

import math
import socket
import ssl
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import httpcore
import httpx

_UNTIL: ContextVar[float] = ContextVar("until", default=math.inf)


@contextmanager
def deadline(until: float) -> Iterator[None]:
    """Requests of this context are given up at a point in time, answers that are still read among them.

    Args:
        until: as ``time.perf_counter()`` counts, s.
    """
    token = _UNTIL.set(until)
    try:
        yield
    finally:
        _UNTIL.reset(token)


class DeadlineTransport(httpx.HTTPTransport):
    """As ``httpx.HTTPTransport`` without proxies and HTTP/2, within :func:`deadline`.

    Args:
        limits: of its connections.
    """

    def __init__(self, limits: httpx.Limits) -> None:
        context = httpx.create_ssl_context(trust_env=False)
        super().__init__(context, trust_env=False, limits=limits)
        # httpx has no argument for what lies under its pool.
        self._pool = httpcore.ConnectionPool(
            ssl_context=context,
            max_connections=limits.max_connections,
            max_keepalive_connections=limits.max_keepalive_connections,
            keepalive_expiry=limits.keepalive_expiry,
            network_backend=_Backend(),
        )


class _Backend(httpcore.NetworkBackend):
    def __init__(self) -> None:
        self._sockets = httpcore.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.NetworkStream:
        options = list(socket_options or ())
        failed: Exception = httpcore.ConnectError(f"{host} has no address")
        # One address at a time: the time limit would else begin anew with every address of the host.
        for address in _addresses(host, port):
            try:
                left_s = _left_s(timeout)
                return _Stream(self._sockets.connect_tcp(address, port, left_s, local_address, options))
            except TimeoutError as error:
                raise httpcore.ConnectTimeout(str(error)) from error
            except (httpcore.ConnectError, httpcore.ConnectTimeout) as error:
                failed = error
        raise failed


class _Stream(httpcore.NetworkStream):
    def __init__(self, inner: httpcore.NetworkStream) -> None:
        self._inner = inner
        self._socket: socket.socket = inner.get_extra_info("socket")

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        try:
            self._socket.settimeout(_left_s(timeout))
            return self._socket.recv(max_bytes)
        except TimeoutError as error:
            raise httpcore.ReadTimeout(str(error)) from error
        except OSError as error:
            raise httpcore.ReadError(str(error)) from error

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        rest = memoryview(buffer)
        try:
            # Not sendall, nor the inner stream's: a server that takes a few bytes at a time would start the
            # time limit anew with each of them.
            while rest:
                self._socket.settimeout(_left_s(timeout))
                rest = rest[self._socket.send(rest) :]
        except TimeoutError as error:
            raise httpcore.WriteTimeout(str(error)) from error
        except OSError as error:
            raise httpcore.WriteError(str(error)) from error

    def close(self) -> None:
        self._inner.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        try:
            left_s = _left_s(timeout)
        except TimeoutError as error:
            self.close()
            raise httpcore.ConnectTimeout(str(error)) from error
        return _Stream(self._inner.start_tls(ssl_context, server_hostname, left_s))

    def get_extra_info(self, info: str) -> Any:
        return self._inner.get_extra_info(info)


def _addresses(host: str, port: int) -> list[str]:
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise httpcore.ConnectError(str(error)) from error
    # A link-local address of IPv6 is nothing without its scope.
    return [f"{at[0]}%{at[3]}" if len(at) == 4 and at[3] else str(at[0]) for *_, at in found]


def _left_s(timeout: float | None) -> float | None:
    """What an operation may take.

    Raises:
        TimeoutError: the deadline has passed.
    """
    until = _UNTIL.get()
    if until == math.inf:
        return timeout
    left_s = until - time.perf_counter()
    if left_s <= 0.0:
        raise TimeoutError("the deadline has passed")
    return left_s if timeout is None else min(timeout, left_s)
