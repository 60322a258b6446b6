"""Ports of the loopback address: whether one is free, and who holds it if not."""

import socket

import psutil

from cspace.errors import PortTakenError
from services.local.settings import HOST


def is_free(port: int) -> bool:
    """Whether nobody listens on a loopback port and a service could."""
    with socket.socket() as client:
        client.settimeout(1.0)
        # A listener on all addresses lets others bind the loopback address on some systems.
        if client.connect_ex((HOST, port)) == 0:
            return False
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((HOST, port))
        except OSError:
            return False
    return True


def require_free(port: int, service: str, setting: str) -> None:
    """Raise PortTakenError, naming the setting to change, where a port is not free."""
    if is_free(port):
        return
    raise PortTakenError(
        f"port {port} of {service} is taken",
        expected="a free port",
        got=holder(port) or "a listener of another user",
        remedy=f"end that process, or set {setting} to a free port and run the command again",
    )


def holder(port: int) -> str | None:
    """Who listens on a port as text, or None where the system does not tell."""
    try:
        connections = psutil.net_connections(kind="tcp")
    except psutil.Error:
        return None
    for connection in connections:
        listens = connection.status == psutil.CONN_LISTEN
        if listens and connection.laddr and connection.laddr.port == port and connection.pid:
            return _describe(connection.pid)
    return None


def free_ports(count: int) -> list[int]:
    """Different free loopback ports, chosen by the system."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind((HOST, 0))
        return [int(one.getsockname()[1]) for one in sockets]
    finally:
        for one in sockets:
            one.close()


def _describe(pid: int) -> str:
    try:
        command = " ".join(psutil.Process(pid).cmdline())
    except psutil.Error:
        return f"process {pid}"
    return f"process {pid}: {command[:120]}"
