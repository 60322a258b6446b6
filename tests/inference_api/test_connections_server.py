"""Attacks on the connections of a real server: it refuses or cuts them, and answers others all the while."""

import json
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from tests.inference_api.answers import IMAGE
from tests.inference_api.raw import (
    HEALTH,
    connect,
    everything,
    head,
    lives,
    metric,
    one_answer,
    peak_mib,
    until,
)
from tests.inference_api.server import ServerProcess, server_process

pytestmark = pytest.mark.e2e

MIB = 1024 * 1024
CUT_S = 1.0
BODY = json.dumps({"image": IMAGE, "n": 3}).encode()
JSON = "Content-Type: application/json"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ServerProcess]:
    """With little patience."""
    settings = {
        "CSPACE_PRETRAINED_MODEL": str(bundles["plain"]),
        "CSPACE_API_HEADER_TIMEOUT_S": str(CUT_S),
        "CSPACE_API_WRITE_TIMEOUT_S": str(CUT_S),
    }
    with server_process(tmp_path_factory.mktemp("connections"), settings) as found:
        yield found


@pytest.fixture(scope="module")
def address(server: ServerProcess) -> str:
    return server.address


def pour(link: socket.socket, piece: bytes, size: int) -> int:
    """Send a piece over and over until so much is sent, or the server has had enough."""
    sent = 0
    with suppress(OSError):
        while sent < size:
            link.sendall(piece)
            sent += len(piece)
    return sent


CHUNKED = head("POST", "/sample", JSON, "Transfer-Encoding: chunked")
FLOODS = {
    "many headers": (b"GET /models HTTP/1.1\r\n", b"X: yyyyyyyyyyyyyyyyyyyyyyyyyyyy\r\n" * 4096),
    "one header": (b"GET /models HTTP/1.1\r\nX: ", b"y" * 131_072),
    "a path": (b"GET /", b"y" * 131_072),
    "a header's name": (b"GET /models HTTP/1.1\r\n", b"y" * 131_072),
    "trailers": (CHUNKED + b"1\r\n{\r\n0\r\n", b"X: yyyyyyyyyyyyyyyyyyyyyyyyyyyy\r\n" * 4096),
    "one trailer": (CHUNKED + b"1\r\n{\r\n0\r\nX: ", b"y" * 131_072),
    "a chunk's extension": (CHUNKED + b"1;", b"y" * 131_072),
}


@pytest.mark.parametrize("flood", FLOODS.values(), ids=FLOODS)
def test_a_flood_without_end_takes_no_memory(server: ServerProcess, flood: tuple[bytes, bytes]) -> None:
    before = peak_mib(server.process.pid)
    start, piece = flood
    with connect(server.address) as link:
        link.sendall(start)
        sent = pour(link, piece, 300 * MIB)
    assert lives(server.address)
    assert sent < 64 * MIB
    assert peak_mib(server.process.pid) - before < 32


@pytest.mark.parametrize(
    ("sent", "status", "name"),
    [
        (b"\x00\x01 nothing of the kind\r\n\r\n", 400, "malformed-request"),
        (CHUNKED + b"zz\r\n", 400, "malformed-request"),
        (CHUNKED + b"1;" + b"y" * 400_000, 431, "headers-too-large"),
    ],
    ids=["no HTTP", "a chunk", "an extension"],
)
def test_the_lowest_layer_answers_with_problems(
    server: ServerProcess, sent: bytes, status: int, name: str
) -> None:
    with connect(server.address) as link:
        link.sendall(sent[:1000])
        link.sendall(sent[1000:])
        answer = everything(link)
    start, _, body = answer.partition(b"\r\n\r\n")
    assert start.startswith(b"HTTP/1.1 %d " % status)
    assert json.loads(body)["type"] == f"urn:cspace-sampler:problem:{name}"
    for line in (b"connection: close", b"x-content-type-options: nosniff", b"cache-control: no-store"):
        assert b"\r\n" + line in start
    request_id = start.partition(b"x-request-id: ")[2][:32].decode()
    (line,) = (line for line in server.log.read_text().splitlines() if request_id in line)
    assert line.startswith(f"INFO:     other unknown {status} ")
    assert line.endswith(f"reason={name}")
    text = httpx.get(f"{server.address}/metrics").text
    assert f'cspace_requests_total{{method="other",route="unknown",status="{status}"}}' in text


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (head("GET", "/models", *["X: y"] * 100), 431),
        (head("GET", "/models", "X: " + "y" * 35_000), 431),
        (head("GET", "/" + "y" * 9000), 414),
    ],
    ids=["headers", "a header", "a path"],
)
def test_too_many_headers_and_a_long_path_are_refused(address: str, sent: bytes, status: int) -> None:
    with connect(address) as link:
        link.sendall(sent)
        assert one_answer(link).startswith(b"HTTP/1.1 %d " % status)


def test_a_large_head_within_the_bounds_is_answered(address: str) -> None:
    sent = head("GET", "/models?" + "y" * 8000, *["X: " + "y" * 240] * 90)
    with connect(address) as link:
        for at in range(0, len(sent), 1000):
            link.sendall(sent[at : at + 1000])
        assert one_answer(link).startswith(b"HTTP/1.1 200 ")


def test_trailers_change_neither_their_request_nor_the_next(address: str) -> None:
    sent = head("POST", "/sample", JSON, "X-Request-ID: first", "Transfer-Encoding: chunked")
    sent += b"%x\r\n%s\r\n0\r\nX-Request-ID: smuggled\r\n\r\n" % (len(BODY), BODY)
    with connect(address) as link:
        link.sendall(sent)
        assert b"\r\nx-request-id: first\r\n" in one_answer(link)
        link.sendall(HEALTH)
        assert b"smuggled" not in one_answer(link)


@pytest.mark.parametrize("start", [b"", b"GET /models HTTP/1.1\r\nHost: local"])
def test_a_head_that_comes_too_slowly_is_cut_at_the_deadline(address: str, start: bytes) -> None:
    with connect(address) as link:
        link.sendall(start)
        began = time.monotonic()
        link.settimeout(0.2)
        answer = b""
        while time.monotonic() - began < 10 * CUT_S:
            try:
                chunk = link.recv(65536)
            except TimeoutError:
                # A byte now and then does not help.
                with suppress(OSError):
                    link.sendall(b"y" * bool(start))
                continue
            except OSError:
                break
            if not chunk:
                break
            answer += chunk
        assert CUT_S * 0.9 < time.monotonic() - began < 4 * CUT_S
    assert answer.startswith(b"HTTP/1.1 408 ") if start else answer == b""


def test_a_second_head_has_its_deadline_too_and_a_quiet_connection_stays(address: str) -> None:
    with connect(address) as slow, connect(address) as quiet:
        for link in (slow, quiet):
            link.sendall(HEALTH)
            assert one_answer(link).startswith(b"HTTP/1.1 200 ")
        slow.sendall(HEALTH[:20])
        assert b"headers-timeout" in everything(slow)
        quiet.sendall(HEALTH)
        assert one_answer(quiet).startswith(b"HTTP/1.1 200 ")


def test_a_client_that_is_always_a_few_requests_ahead_is_answered(address: str) -> None:
    with connect(address) as link:
        link.sendall(20 * HEALTH)
        received = b""
        for sent in range(20, 200):
            while received.count(b"HTTP/1.1 200 ") < sent - 19:
                received += link.recv(65536)
            link.sendall(HEALTH)
        while received.count(b"HTTP/1.1 200 ") < 200:
            received += link.recv(65536)
    assert b"HTTP/1.1 400 " not in received


def test_a_refusal_after_the_whole_body_keeps_the_connection(address: str) -> None:
    with connect(address) as link:
        for _ in range(3):
            link.sendall(head("POST", "/sample", "Content-Type: x/y", "Content-Length: 2") + b"{}")
            assert one_answer(link).startswith(b"HTTP/1.1 415 ")


def test_a_client_that_sends_on_reads_its_answer_and_no_reset(address: str) -> None:
    with connect(address) as link:
        link.sendall(head("POST", "/nothing", "Content-Length: 200000"))
        for _ in range(3):
            link.sendall(bytes(65_536))
        assert one_answer(link).startswith(b"HTTP/1.1 404 ")


def test_the_rest_of_a_refused_body_is_thrown_away_only_for_so_long(address: str) -> None:
    with connect(address) as link:
        link.sendall(head("POST", "/nothing", "Transfer-Encoding: chunked"))
        assert one_answer(link).startswith(b"HTTP/1.1 404 ")
        began = time.monotonic()
        with suppress(OSError):
            while time.monotonic() - began < 20 * CUT_S:
                link.sendall(b"1\r\nx\r\n")
                time.sleep(0.05)
        assert time.monotonic() - began < 10 * CUT_S


@pytest.mark.parametrize("protocol", ["websocket", "h2c"])
def test_a_wish_for_another_protocol_passes_the_guards_and_leaves_one_line(
    server: ServerProcess, protocol: str
) -> None:
    before = server.log.read_text()
    forged = "/models?%0AINFO:     forged"
    further = ("Connection: Upgrade", f"Upgrade: {protocol}", "Sec-WebSocket-Key: eA==")
    with connect(server.address) as link:
        link.sendall(head("GET", forged.replace(" ", "%20"), *further, "Sec-WebSocket-Version: 13"))
        answer = one_answer(link)
    assert answer.startswith(b"HTTP/1.1 200 ")
    with connect(server.address) as link:
        link.sendall(head("GET", "/models", *further).replace(b"localhost", b"evil.example"))
        assert one_answer(link).startswith(b"HTTP/1.1 421 ")
    until(lambda: server.log.read_text()[len(before) :].count("INFO:     GET /models ") == 2)
    added = server.log.read_text()[len(before) :].splitlines()
    assert len(added) == 2
    assert all(line.startswith("INFO:     GET /models ") and "forged" not in line for line in added)


def test_a_client_that_leaves_while_it_is_answered_leaves_one_line(server: ServerProcess) -> None:
    before = len(server.log.read_text())
    with connect(server.address) as link:
        link.sendall(head("POST", "/sample", JSON, f"Content-Length: {len(BODY)}", "X-Request-ID: gone"))
        link.sendall(BODY[:10])
        until(lambda: metric(server.address, "cspace_requests_in_flight") > 1)
    until(lambda: "request_id=gone" in server.log.read_text()[before:])
    added = server.log.read_text()[before:]
    assert added.count("request_id=gone") == 1
    assert "Traceback" not in added
