"""Keys, limits, log and shutdown of a real process."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from tests.inference_api.answers import IMAGE, PNG, assert_problem
from tests.inference_api.server import ROOT, ServerProcess, server_process

pytestmark = pytest.mark.e2e
BODY = json.dumps({"image": IMAGE, "n": 3}).encode()
LOOKS, LOOK_S = 200, 0.05


@contextmanager
def half_sent(server: ServerProcess, *headers: str) -> Iterator[socket.socket]:
    """A connection on which half of a request for samples has been sent."""
    target = urlsplit(server.address)
    head = ("POST /sample HTTP/1.1", "Host: localhost", "Content-Type: application/json", *headers)
    lines = "\r\n".join((*head, f"Content-Length: {len(BODY)}", "", ""))
    with socket.create_connection((target.hostname, target.port), timeout=60) as connection:
        connection.sendall(lines.encode() + BODY[:20])
        yield connection


def rest_of(connection: socket.socket) -> str:
    """Everything that comes until the server closes the connection, or a whole answer was read."""
    answer = b""
    while chunk := connection.recv(65536):
        answer += chunk
        head, found, body = answer.partition(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", head)
        if found and length and len(body) >= int(length[1]):
            break
    return answer.decode()


def wait_until(holds: Callable[[], bool]) -> None:
    for _ in range(LOOKS):
        if holds():
            return
        time.sleep(LOOK_S)
    raise AssertionError("it did not come to hold")


def in_flight(address: str, headers: dict[str, str]) -> float:
    text = httpx.get(f"{address}/metrics", headers=headers, timeout=30).text
    found = re.search(r"^cspace_requests_in_flight (\S+)$", text, re.MULTILINE)
    assert found, text
    return float(found[1])


@pytest.fixture(scope="module")
def key_and_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A key from the real command."""
    command = [sys.executable, "-m", "inference_api.keys", "robot"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    shown, line = told.stdout.splitlines()
    path = tmp_path_factory.mktemp("keys") / "keys"
    path.write_text(line + "\n")
    return shown.rpartition(" ")[2], path


def test_a_server_with_keys_and_one_place(
    tmp_path: Path, bundles: dict[str, Path], key_and_file: tuple[str, Path]
) -> None:
    key, path = key_and_file
    bearer = {"Authorization": f"Bearer {key}"}
    settings = {
        "CSPACE_PRETRAINED_MODEL": str(bundles["plain"]),
        "CSPACE_API_KEYS_FILE": str(path),
        "CSPACE_API_MAX_IN_FLIGHT": "1",
    }
    with server_process(tmp_path, settings, "--log", "json") as server:
        assert_problem(httpx.get(f"{server.address}/models", timeout=30), 401, "unauthorized")
        assert httpx.get(f"{server.address}/health/ready", timeout=30).status_code == 200
        with half_sent(server, f"Authorization: Bearer {key}", "X-Request-ID: slow") as connection:
            wait_until(lambda: in_flight(server.address, bearer) >= 2)
            refused = httpx.get(f"{server.address}/models", headers=bearer, timeout=30)
            assert_problem(refused, 503, "overloaded")
            assert refused.headers["retry-after"] == "1"
            assert "server" not in refused.headers
            server.process.send_signal(signal.SIGTERM)
            wait_until(lambda: not listens(server.address))
            connection.sendall(BODY[20:])
            answer = rest_of(connection)
        assert answer.startswith("HTTP/1.1 200 ")
        assert len(json.loads(answer.partition("\r\n\r\n")[2])["samples"]) == 3
        assert server.process.wait(30) == 0
    lines = [json.loads(line) for line in server.log.read_text().splitlines()[1:]]
    (slow,) = (line for line in lines if line.get("request_id") == "slow")
    assert (slow["status"], slow["client"], slow["n"], slow["model"]) == (200, "robot", 3, "pretrained/0")
    assert any(line["message"] == "Shutting down" for line in lines)
    assert key not in server.log.read_text()


def listens(address: str) -> bool:
    target = urlsplit(address)
    try:
        socket.create_connection((target.hostname, target.port), timeout=5).close()
    except OSError:
        return False
    return True


def test_a_server_with_little_patience(tmp_path: Path, bundles: dict[str, Path]) -> None:
    settings = {
        "CSPACE_PRETRAINED_MODEL": str(bundles["plain"]),
        "CSPACE_API_BODY_TIMEOUT_S": "0.2",
        "CSPACE_API_RATE": "0.001",
        "CSPACE_API_BURST": "3",
    }
    with server_process(tmp_path, settings) as server:
        with half_sent(server) as connection:
            answer = rest_of(connection)
            assert answer.startswith("HTTP/1.1 408 ")
            assert "urn:cspace-sampler:problem:request-timeout" in answer
            assert "\r\nconnection: close\r\n" in answer
            assert connection.recv(1) == b""
        answers = [httpx.post(f"{server.address}/sample", files={"image": PNG}, timeout=30) for _ in range(3)]
        assert [answer.status_code for answer in answers] == [200, 200, 429]
        assert_problem(answers[2], 429, "too-many-requests")
    assert "POST /sample 408" in server.log.read_text()


def test_all_addresses_without_keys_is_refused_with_a_remedy() -> None:
    command = [sys.executable, "-m", "inference_api", "--port", "0", "--host", "0.0.0.0"]  # noqa: S104
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert told.returncode == 2
    assert "CSPACE_API_KEYS_FILE" in told.stderr
    assert "--allow-unauthenticated" in told.stderr
    assert "Traceback" not in told.stderr
