"""Places that one client would keep from others: connections, answers that nobody reads, slow bodies."""

import json
import resource
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from inference_api.keys import digest_of
from tests.inference_api.answers import IMAGE
from tests.inference_api.raw import (
    HEALTH,
    connect,
    head,
    is_quiet,
    lives,
    metric,
    one_answer,
    peak_mib,
    until,
)
from tests.inference_api.server import ServerProcess, server_process

pytestmark = pytest.mark.e2e

BODY = json.dumps({"image": IMAGE, "n": 3}).encode()
JSON = "Content-Type: application/json"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ServerProcess]:
    """With little patience."""
    settings = {
        "CSPACE_PRETRAINED_MODEL": str(bundles["plain"]),
        "CSPACE_API_HEADER_TIMEOUT_S": "1.0",
        "CSPACE_API_WRITE_TIMEOUT_S": "1.0",
    }
    with server_process(tmp_path_factory.mktemp("places"), settings) as found:
        yield found


@pytest.mark.slow
def test_a_client_that_reads_no_answers_is_cut_and_its_places_are_free(server: ServerProcess) -> None:
    before = peak_mib(server.process.pid)
    # Each asks for all samples there are, so that the buffers of both sides overflow.
    request = json.dumps({"image": IMAGE, "n": 20_000}).encode()
    sent = head("POST", "/sample", JSON, f"Content-Length: {len(request)}") + request
    with ExitStack() as stack:
        links = [stack.enter_context(connect(server.address)) for _ in range(8)]
        for link in links:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            link.sendall(20 * sent)
        until(lambda: metric(server.address, "cspace_requests_in_flight") > 1)
        assert lives(server.address)
        until(lambda: metric(server.address, "cspace_requests_in_flight") <= 1, 60.0)
        until(lambda: metric(server.address, "cspace_connections") <= 2, 60.0)
    assert peak_mib(server.process.pid) - before < 200
    assert "Traceback" not in server.log.read_text()


def test_six_hundred_idle_connections_shut_nobody_out(server: ServerProcess) -> None:
    address = server.address
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 2048)), hard))
    with ExitStack() as stack:
        other = stack.enter_context(connect(address, "127.0.0.2"))
        other.sendall(HEALTH)
        assert one_answer(other).startswith(b"HTTP/1.1 200 ")
        links = []
        for _ in range(600):
            link = stack.enter_context(connect(address))
            link.sendall(HEALTH)
            assert one_answer(link).startswith(b"HTTP/1.1 200 ")
            links.append(link)
        assert lives(address)
        assert metric(address, "cspace_connections") <= 512
        # Those that waited longest had to go, but only of the address that had so many.
        assert not is_quiet(links[0])
        assert is_quiet(links[-1])
        assert is_quiet(other)
    until(lambda: metric(address, "cspace_connections") <= 2)


def test_slow_bodies_of_one_key_leave_places_for_another(tmp_path: Path, bundles: dict[str, Path]) -> None:
    keys = tmp_path / "keys"
    keys.write_text(f"a:{digest_of('csk_a')}\nb:{digest_of('csk_b')}\n")
    keys.chmod(0o600)
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"]), "CSPACE_API_KEYS_FILE": str(keys)}
    with server_process(tmp_path, settings) as server, ExitStack() as stack:
        links = []
        for _ in range(64):
            link = stack.enter_context(connect(server.address))
            fields = ("Authorization: Bearer csk_a", f"Content-Length: {len(BODY)}")
            link.sendall(head("POST", "/sample", JSON, *fields) + BODY[:9])
            links.append(link)
        bearer = {"authorization": "Bearer csk_b"}
        until(lambda: metric(server.address, "cspace_requests_in_flight", bearer) >= 48)
        with httpx.Client(headers=bearer, timeout=30) as client:
            answers = [
                client.post(f"{server.address}/sample", json={"image": IMAGE, "n": 3}) for _ in range(15)
            ]
        assert [answer.status_code for answer in answers] == [200] * 15
        assert lives(server.address)
        refused = [one_answer(link) for link in links if not is_quiet(link)]
        assert len(refused) == 16
        metrics = httpx.get(f"{server.address}/metrics", headers=bearer).text
        assert 'cspace_failures_total{reason="overloaded"} 16.0' in metrics
