"""Requests whose clients have gone away, and dear ones beside cheap ones, at a real server."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.serving.attack_requests import png, read_answer, request, sample
from tests.inference_api.raw import connect, metric, until
from tests.inference_api.server import ServerProcess, server_process

pytestmark = pytest.mark.e2e

PATIENCE_S = 60.0
LEFT = 30
DEAREST = sample(png(48), n="20000", min_confidence="1", model="pretrained")
CHEAP = sample(png(48), n="5", seed="7")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ServerProcess]:
    """The model that ships, on one thread, for the tiny ones of other tests cost nothing."""
    with server_process(tmp_path, {"CSPACE_API_THREADS": "1"}, "--log", "json") as found:
        yield found


def comes_to(server: ServerProcess, name: str, value: float) -> None:
    until(lambda: metric(server.address, name) == value, PATIENCE_S)


def reasons(server: ServerProcess) -> list[str]:
    lines = [line for line in server.log.read_text().splitlines() if line.startswith("{")]
    return [line["reason"] for line in map(json.loads, lines) if "reason" in line]


def test_what_was_left_is_not_computed_and_each_leaves_one_line(server: ServerProcess) -> None:
    links = [connect(server.address) for _ in range(LEFT)]
    for link in links:
        link.sendall(DEAREST)
    comes_to(server, "cspace_requests_waiting", LEFT - 1)
    for link in links:
        link.close()
    comes_to(server, "cspace_requests_in_flight", 1)
    assert metric(server.address, "cspace_samples_requested_total") == 0
    assert reasons(server) == ["client-gone"] * LEFT
    assert "Traceback" not in server.log.read_text()


def test_a_cheap_request_is_answered_before_the_dear_ones_that_came_first(server: ServerProcess) -> None:
    dear = [connect(server.address) for _ in range(5)]
    for link in dear:
        link.sendall(DEAREST)
    comes_to(server, "cspace_requests_waiting", len(dear) - 1)
    with connect(server.address) as link:
        link.sendall(CHEAP)
        answer = read_answer(link)
    assert answer.startswith(b"HTTP/1.1 200 ")
    # None of the dear ones is done by then.
    assert metric(server.address, "cspace_samples_requested_total") == 5
    for link in dear:
        link.close()


def test_a_client_that_leaves_behind_a_large_body_is_seen_to_go(server: ServerProcess) -> None:
    rows = [[0.123456789012345, 1.123456789012345]] * 20_000
    body = json.dumps({"image": base64.b64encode(png(48)).decode(), "configurations": rows}).encode()
    with connect(server.address) as link:
        link.sendall(DEAREST)
        comes_to(server, "cspace_requests_in_flight", 2)
        with connect(server.address) as leaving:
            leaving.sendall(request("/validity", body, "application/json"))
            comes_to(server, "cspace_requests_waiting", 1)
        comes_to(server, "cspace_requests_in_flight", 2)
        assert reasons(server) == ["client-gone"]
