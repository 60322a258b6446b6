"""The network under the synchronous client: TLS, connections that went stale, one deadline."""

import socket
import ssl
import subprocess
import time
from contextlib import AbstractContextManager
from pathlib import Path

import httpx
import pytest

from cspace_client import transport
from cspace_client.client import SamplingClient
from cspace_client.errors import SamplerUnavailableError
from cspace_client.transport import DeadlineTransport, RetryPolicy, deadline
from tests.services.planner.hostile_server import (
    SEED,
    HostileServer,
    N,
    Script,
    ends,
    head,
    hostile_server,
    plays,
    repeats,
    whole,
)

PNG = b"\x89PNG picture"
ONCE = RetryPolicy(attempts=1, deadline_s=5.0)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A certificate for localhost, signed by itself, with its key."""
    folder = tmp_path_factory.mktemp("tls")
    made, key = folder / "certificate.pem", folder / "key.pem"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    kind = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    command = ["openssl", "req", "-x509", *kind, *names, "-out", str(made), "-keyout", str(key)]
    subprocess.run(command, check=True, capture_output=True)
    made.write_text(made.read_text() + key.read_text())
    return made


@pytest.fixture
def trusted(certificate: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def trusting(**_: object) -> ssl.SSLContext:
        return ssl.create_default_context(cafile=str(certificate))

    monkeypatch.setattr(transport.httpx, "create_ssl_context", trusting)


def over_tls(certificate: Path, script: Script) -> AbstractContextManager[HostileServer]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    return hostile_server(script, wrap=lambda link: context.wrap_socket(link, server_side=True))


def secure(server: HostileServer) -> str:
    return server.url.replace("http://127.0.0.1", "https://localhost")


def test_requests_over_tls_share_a_connection(certificate: Path, trusted: None) -> None:
    with over_tls(certificate, plays(whole())) as server, SamplingClient(secure(server)) as client:
        for _ in range(3):
            assert client.sample(PNG, N, seed=SEED).fallback is False
    assert (server.connections, len(server.heads)) == (1, 3)


def test_a_dripping_answer_over_tls_is_left_at_the_deadline(certificate: Path, trusted: None) -> None:
    policy = RetryPolicy(attempts=1, deadline_s=0.3)
    script = repeats(head(), b"X-More: 1\r\n", 0.02)
    with over_tls(certificate, script) as server, SamplingClient(secure(server), policy=policy) as client:
        began = time.monotonic()
        with pytest.raises(SamplerUnavailableError, match=r"0\.3 s in all"):
            client.sample(PNG, N, seed=SEED)
        assert time.monotonic() - began < 3.0


def test_a_certificate_of_nobody_is_not_trusted(certificate: Path) -> None:
    with over_tls(certificate, plays(whole())) as server:
        client = SamplingClient(secure(server), policy=ONCE)
        with client, pytest.raises(SamplerUnavailableError, match="CERTIFICATE_VERIFY_FAILED"):
            client.sample(PNG, N, seed=SEED)
    assert server.heads == []


def test_a_connection_that_the_server_closed_is_replaced_unseen() -> None:
    with hostile_server(ends(whole())) as server, SamplingClient(server.url, policy=ONCE) as client:
        client.sample(PNG, N, seed=SEED)
        kept = client._transport._pool.connections
        until = time.monotonic() + 5.0
        while not all(one.has_expired() for one in kept) and time.monotonic() < until:
            pass
        client.sample(PNG, N, seed=SEED)
    assert server.connections == 2


def test_a_host_of_many_addresses_has_one_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    timeouts: list[float] = []

    def never(self: object, host: str, port: int, timeout: float, *_: object) -> None:
        timeouts.append(timeout)
        time.sleep(min(timeout, 0.06))
        raise transport.httpcore.ConnectTimeout("late")

    addresses = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (f"192.0.2.{at}", 80)) for at in range(1, 200)]
    monkeypatch.setattr(transport.socket, "getaddrinfo", lambda *_, **__: addresses)
    monkeypatch.setattr(transport.httpcore.SyncBackend, "connect_tcp", never)
    client = SamplingClient("http://many.test", policy=RetryPolicy(attempts=1, deadline_s=0.3))
    with client, pytest.raises(SamplerUnavailableError, match="in time"):
        client.sample(PNG, N, seed=SEED)
    assert 1 < len(timeouts) <= 6
    assert sum(min(value, 0.06) for value in timeouts) <= 0.3


def test_without_a_deadline_the_request_s_own_limits_hold() -> None:
    transport = DeadlineTransport(httpx.Limits())
    with hostile_server(plays(b"")) as server, httpx.Client(transport=transport) as client:
        with pytest.raises(httpx.ReadTimeout, match="timed out"):
            client.post(server.url, content=b"x", timeout=0.05)
        with deadline(time.perf_counter() - 1.0), pytest.raises(TimeoutError, match="deadline"):
            client.post(server.url, content=b"x")
