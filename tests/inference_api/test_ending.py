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

STUCK = """
import signal, sys, threading, time
from inference_api.process import end_in_time
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
end_in_time(float(sys.argv[1]))
if len(sys.argv) > 2:
    threading.Thread(target=time.sleep, args=(60.0,)).start()
print("ready", flush=True)
time.sleep(60.0)
"""
GRACE_S = 1


def told_to_end(*arguments: str) -> tuple[int, float, bytes]:
    """Exit code of a process that is told to end, the time that it takes, in s, and what it writes."""
    command = [sys.executable, "-c", STUCK, *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.readline()
        process.terminate()
        began = time.monotonic()
        code = process.wait(30)
        return code, time.monotonic() - began, process.stderr.read()


def test_a_thread_that_does_not_end_holds_its_process_up_for_the_grace_alone() -> None:
    code, took_s, wrote = told_to_end("0.2", "stuck")
    assert code == FORCED
    assert 0.2 + MARGIN_S <= took_s < 0.2 + MARGIN_S + 3
    assert b"is ended" in wrote


def test_a_process_without_such_a_thread_ends_at_once_and_in_order() -> None:
    code, took_s, wrote = told_to_end("20")
    assert (code, wrote) == (0, b"")
    assert took_s < 5


SERVER = """
import sys, threading, time
from inference_api.__main__ import main
threading.Thread(target=time.sleep, args=(60.0,)).start()
sys.exit(main(["--port", "0"]))
"""


@pytest.mark.e2e
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


@pytest.mark.e2e
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


@pytest.mark.e2e
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
