"""Bytes that no client would send, over plain sockets: no 5xx, no hang, and the next request is answered."""

import random
import socket
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from tests.inference_api.server import api_server

pytestmark = pytest.mark.e2e

BODY_TIMEOUT_S = 2
PATIENCE_S = 15.0
FIELD = b'--edge\r\nContent-Disposition: form-data; name="n"\r\n\r\n5\r\n'
FILE = b'--edge\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
END = b"\r\n--edge--\r\n"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[str]:
    chosen = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"])}
    chosen["CSPACE_API_BODY_TIMEOUT_S"] = str(BODY_TIMEOUT_S)
    with api_server(tmp_path_factory.mktemp("sockets"), chosen) as found:
        yield found


def head(length: int | str, *further: bytes) -> bytes:
    lines = [
        b"POST /sample HTTP/1.1",
        b"Host: localhost",
        b"Content-Type: multipart/form-data; boundary=edge",
    ]
    return b"\r\n".join([*lines, b"Content-Length: %s" % str(length).encode(), *further, b"", b""])


def exchange(address: str, data: bytes, *, end: bool = False) -> bytes:
    """What comes back until the server closes, or has answered and waits for more.

    Args:
        address: of the server.
        data: what is sent.
        end: whether this side then closes its half, as a client that has gone.
    """
    parts = urlsplit(address)
    with socket.create_connection((parts.hostname, parts.port), timeout=PATIENCE_S) as link:
        try:
            link.sendall(data)
            if end:
                link.shutdown(socket.SHUT_WR)
            answer = b""
            while chunk := link.recv(65536):
                answer += chunk
                link.settimeout(0.5)
        except TimeoutError:
            assert answer, "neither an answer nor a close"
        except OSError:
            # The server has closed before it had all of it.
            answer = b""
        return answer


def check(address: str, answer: bytes, png: bytes) -> None:
    """Refused or closed, and the server goes on."""
    if answer:
        assert answer.startswith(b"HTTP/1.1 "), answer[:100]
        assert int(answer.split()[1]) < 500, answer[:300]
    again = httpx.post(f"{address}/sample", files={"image": png}, data={"n": "3"}, timeout=PATIENCE_S)
    assert again.status_code == 200
    assert len(again.json()["samples"]) == 3


def whole(png: bytes) -> bytes:
    body = FIELD + FILE + png + END
    return head(len(body)) + body


CASES = {
    "not HTTP": b"\x00\x01\x02 nothing of the kind\r\n\r\n",
    "another version": b"GET / HTTP/9.9\r\n\r\n",
    "a method like none": b"DANCE /sample HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "no host": b"GET /health/live HTTP/1.1\r\n\r\n",
    "a length below zero": head(-5),
    "a length that is no number": head("many"),
    "two lengths": head(3, b"Content-Length: 4") + b"abcd",
    "length and chunks": head(3, b"Transfer-Encoding: chunked") + b"zz\r\n",
    "a chunk of no size": head(0)[:-2].replace(b"Content-Length: 0\r\n", b"Transfer-Encoding: chunked\r\n")
    + b"\r\nxyz\r\n",
    "a length beyond all bounds": head(10**15),
    "a form without its end": head(len(FIELD)) + FIELD,
    "a form of its end alone": head(len(END)) + END,
    "a part without a header's end": head(len(FILE) - 4) + FILE[:-4],
    "a part that names nothing": head(30) + b"--edge\r\nContent-Disposition\r\n\r\n"[:30],
    "a longer body than told": head(10) + FIELD * 3,
    "a flood of headers": head(0, *[b"X-%d: %s" % (i, b"y" * 1000) for i in range(300)]),
    "one endless header": head(0, b"X-Long: " + b"y" * 300_000),
    "a path without an end": b"GET /" + b"a" * 300_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "escapes in the path": b"GET /%00%ff/..%2f..%2fetc HTTP/1.1\r\nHost: localhost\r\n\r\n",
}


@pytest.mark.parametrize("data", CASES.values(), ids=CASES)
def test_what_is_no_request_is_refused_or_dropped(address: str, png: bytes, data: bytes) -> None:
    check(address, exchange(address, data, end=True), png)


def test_a_body_that_stops_half_way_is_given_up(address: str, png: bytes) -> None:
    # This side keeps its half open, as a client that has lost its way does.
    answer = exchange(address, whole(png)[:-20])
    assert answer.startswith(b"HTTP/1.1 408 ")
    check(address, answer, png)


def test_a_client_that_leaves_half_way_leaves_no_trace(address: str, png: bytes) -> None:
    data = whole(png)
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        check(address, exchange(address, data[: int(share * len(data))], end=True), png)


def test_requests_in_one_go_are_answered_in_turn(address: str, png: bytes) -> None:
    answer = exchange(address, 3 * whole(png))
    assert answer.count(b"HTTP/1.1 200 OK") == 3
    check(address, answer[:12] + b" ", png)


@pytest.mark.parametrize(
    "seed", [*range(4), *(pytest.param(s, marks=pytest.mark.slow) for s in range(4, 40))]
)
def test_a_request_with_flipped_and_missing_bytes(address: str, png: bytes, seed: int) -> None:
    rng = random.Random(seed)  # noqa: S311 - a fuzz that can be repeated
    for _ in range(10):
        data = bytearray(whole(png))
        for _ in range(rng.randint(1, 8)):
            at = rng.randrange(len(data))
            if rng.random() < 0.5:
                data[at] = rng.randrange(256)
            else:
                del data[at : at + rng.randint(1, 30)]
        check(address, exchange(address, bytes(data), end=True), png)
