"""A server that is told to end ends: what is in flight is told so, and what hangs does not hold it up."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import psutil
import pytest

from inference_api.process import FORCED, MARGIN_S
from tests.inference_api.raw import connect, everything, head, lives, metric, until
from tests.inference_api.server import ROOT, server_process

pytestmark = pytest.mark.e2e
GRACE_S = 1


SERVER = """
import sys, threading, time
from inference_api.__main__ import main
threading.Thread(target=time.sleep, args=(60.0,)).start()
sys.exit(main(["--port", "0"]))
"""


def test_a_server_with_a_thread_that_hangs_ends_after_its_grace(
    tmp_path: Path, bundles: dict[str, Path]
) -> None:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"]), "CSPACE_API_GRACE_S": str(GRACE_S)}
    environment = {**os.environ, **settings, "CSPACE_MODEL_CACHE": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    environment.pop("MLFLOW_TRACKING_URI", None)
    command = [sys.executable, "-c", SERVER]
    with subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout
        assert process.stderr
        address = process.stdout.readline().decode().split()[2]
        until(lambda: answers(address))
        process.terminate()
        began = time.monotonic()
        assert process.wait(30) == FORCED
        assert time.monotonic() - began < GRACE_S + MARGIN_S + 3
        assert b"is ended" in process.stderr.read()


def answers(address: str) -> bool:
    """Whether a server is there already."""
    try:
        return lives(address)
    except httpx.TransportError:
        return False


def slow_request(request_id: str) -> bytes:
    """A request whose body does not come to its end."""
    fields = ("Content-Type: application/json", "Content-Length: 100", f"X-Request-ID: {request_id}")
    return head("POST", "/sample", *fields) + b"{"


def test_what_is_in_flight_when_the_grace_is_over_is_told_so(
    tmp_path: Path, bundles: dict[str, Path]
) -> None:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"]), "CSPACE_API_GRACE_S": str(GRACE_S)}
    with server_process(tmp_path, settings) as server, connect(server.address) as link:
        link.sendall(slow_request("cut"))
        until(lambda: metric(server.address, "cspace_requests_in_flight") > 1)
        server.process.terminate()
        answer = everything(link)
        start, _, body = answer.partition(b"\r\n\r\n")
        assert start.startswith(b"HTTP/1.1 503 ")
        for line in (
            b"x-request-id: cut",
            b"connection: close",
            b"retry-after: 1",
            b"cache-control: no-store",
        ):
            assert b"\r\n" + line in start
        assert json.loads(body)["type"] == "urn:cspace-sampler:problem:shutting-down"
        assert server.process.wait(GRACE_S + 5) == 0
    assert "POST /sample 503 request_id=cut" in server.log.read_text()
    assert "Traceback" not in server.log.read_text()


@pytest.mark.slow
def test_processes_that_do_not_answer_their_supervisor_are_ended_with_it(
    tmp_path: Path, bundles: dict[str, Path]
) -> None:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"]), "CSPACE_API_GRACE_S": str(GRACE_S)}
    with ExitStack() as stack:
        # The helper expects 0 at the end, and this end is a forced one.
        stack.enter_context(pytest.raises(AssertionError))
        server = stack.enter_context(server_process(tmp_path, settings, "--workers", "2"))
        assert lives(server.address)
        children = psutil.Process(server.process.pid).children()
        for child in children:
            os.kill(child.pid, signal.SIGSTOP)
        server.process.terminate()
        assert server.process.wait(GRACE_S + 10) == FORCED
        _, alive = psutil.wait_procs(children, timeout=5)
        assert not alive
