"""Keys, limits, log and shutdown of a real process."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.inference_api.answers import IMAGE, PNG, assert_problem
from tests.inference_api.raw import connect, head, metric, one_answer, until
from tests.inference_api.server import ROOT, server_process

pytestmark = pytest.mark.e2e
BODY = json.dumps({"image": IMAGE, "n": 3}).encode()


def half_of_a_request(*headers: str) -> bytes:
    return head("POST", "/sample", *headers, f"Content-Length: {len(BODY)}") + BODY[:20]


@pytest.fixture(scope="module")
def key_and_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A key from the real command."""
    command = [sys.executable, "-m", "inference_api.keys", "robot"]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    shown, line = process.stdout.splitlines()
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
        with connect(server.address) as link:
            fields = ("Content-Type: application/json", f"Authorization: Bearer {key}", "X-Request-ID: slow")
            link.sendall(half_of_a_request(*fields))
            until(lambda: metric(server.address, "cspace_requests_in_flight", bearer) >= 2)
            refused = httpx.get(f"{server.address}/models", headers=bearer, timeout=30)
            assert_problem(refused, 503, "overloaded")
            assert refused.headers["retry-after"] == "1"
            assert "server" not in refused.headers
            server.process.send_signal(signal.SIGTERM)
            until(lambda: not listens(server.address))
            link.sendall(BODY[20:])
            answer = one_answer(link)
        assert answer.startswith(b"HTTP/1.1 200 ")
        assert len(json.loads(answer.partition(b"\r\n\r\n")[2])["samples"]) == 3
        assert server.process.wait(30) == 0
    lines = [json.loads(line) for line in server.log.read_text().splitlines()[1:]]
    (slow,) = (line for line in lines if line.get("request_id") == "slow")
    assert (slow["status"], slow["client"], slow["n"], slow["model"]) == (200, "robot", 3, "pretrained/0")
    assert any(line["message"] == "Shutting down" for line in lines)
    assert key not in server.log.read_text()


def listens(address: str) -> bool:
    try:
        connect(address).close()
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
        with connect(server.address) as link:
            link.sendall(half_of_a_request("Content-Type: application/json"))
            answer = one_answer(link)
            assert answer.startswith(b"HTTP/1.1 408 ")
            assert b"urn:cspace-sampler:problem:request-timeout" in answer
            assert b"\r\nconnection: close\r\n" in answer
            assert link.recv(1) == b""
        answers = [httpx.post(f"{server.address}/sample", files={"image": PNG}, timeout=30) for _ in range(3)]
        assert [answer.status_code for answer in answers] == [200, 200, 429]
        assert_problem(answers[2], 429, "too-many-requests")
    assert "POST /sample 408" in server.log.read_text()


def test_all_addresses_without_keys_is_refused_with_a_remedy() -> None:
    command = [sys.executable, "-m", "inference_api", "--port", "0", "--host", "0.0.0.0"]  # noqa: S104
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert process.returncode == 2
    assert "CSPACE_API_KEYS_FILE" in process.stderr
    assert "--allow-unauthenticated" in process.stderr
    assert "Traceback" not in process.stderr
