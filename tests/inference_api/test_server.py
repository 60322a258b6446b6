"""Real processes, real HTTP: what an app in the test's own process cannot show."""

import base64
import io
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span

from cspace.bundle import Bundle
from cspace.worlds.planar.camera import decode_png
from inference_api.limits import MAX_BODY_BYTES
from tests.inference_api.answers import IMAGE, assert_problem
from tests.inference_api.raw import connect, everything, head, metric, one_answer, until
from tests.inference_api.server import ROOT, api_server, server_process
from tests.inference_api.test_depth_pictures import CAMERAS, IMAGES, STATE

pytestmark = pytest.mark.e2e
BODY = json.dumps({"image": IMAGE, "n": 3}).encode()
TRACE, PARENT = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[str]:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"])}
    with api_server(tmp_path_factory.mktemp("server"), settings) as found:
        yield found


def half_of_a_request(*headers: str) -> bytes:
    fields = ("Content-Type: application/json", f"Content-Length: {len(BODY)}")
    return head("POST", "/sample", *headers, *fields) + BODY[:20]


def listens(address: str) -> bool:
    try:
        connect(address).close()
    except OSError:
        return False
    return True


def test_the_same_seed_gives_the_same_bytes_over_http_and_from_the_bundle(
    address: str, png: bytes, bundles: dict[str, Path]
) -> None:
    def ask(seed: int) -> bytes:
        form = {"data": {"n": "500", "seed": str(seed)}, "headers": {"accept": "application/x-npy"}}
        return httpx.post(f"{address}/sample", files={"image": png}, timeout=60, **form).content

    alone = [ask(2**64 - 1 - number) for number in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, [2**64 - 1 - number for number in range(8)])) == alone
    expected = Bundle.load(bundles["plain"]).sample(decode_png(png, 48), 500, 2**64 - 1).samples
    np.testing.assert_array_equal(np.load(io.BytesIO(alone[0])), expected)


def test_a_body_above_the_limit_is_413_over_http(address: str, png: bytes) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65_536 + 2):
            yield bytes(65_536)

    with httpx.Client(timeout=60) as client:
        headers = {"content-type": "application/json"}
        answer = client.post(f"{address}/sample", content=chunks(), headers=headers)
        assert_problem(answer, 413, "body-too-large")
        again = client.post(f"{address}/sample", files={"image": png}, data={"n": "3"})
        assert again.status_code == 200


def test_what_keeps_a_server_from_starting_is_told_with_a_remedy(address: str) -> None:
    for arguments, environment, code, words in (
        (["--port", str(urlsplit(address).port)], {}, 3, "address already in use"),
        (["--port", "0"], {"CSPACE_MODEL_POLL_S": "soon"}, 2, "CSPACE_MODEL_POLL_S"),
        (["--port", "0", "--host", "0.0.0.0"], {}, 2, "--allow-unauthenticated"),  # noqa: S104
    ):
        process = subprocess.run(
            [sys.executable, "-m", "inference_api", *arguments],
            cwd=ROOT,
            env={"HOME": "/nonexistent", **environment},
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert process.returncode == code
        assert words in process.stderr
        assert "Traceback" not in process.stderr


def test_a_server_with_keys_and_one_place_ends_with_what_is_in_flight(
    tmp_path: Path, bundles: dict[str, Path]
) -> None:
    # As docs/operations.md makes one.
    command = """umask 077; key=csk_$(openssl rand -hex 32) && echo "$key"
        echo "robot:$(printf %s "$key" | sha256sum | cut -c -64)" >> keys"""
    made = subprocess.run(["/bin/sh", "-c", command], cwd=tmp_path, capture_output=True, check=True)
    key, path = made.stdout.decode().strip(), tmp_path / "keys"
    bearer = {"Authorization": f"Bearer {key}"}
    settings = {
        "CSPACE_PRETRAINED_MODEL": str(bundles["plain"]),
        "CSPACE_API_KEYS_FILE": str(path),
        "CSPACE_API_MAX_IN_FLIGHT": "1",
    }
    with server_process(tmp_path, settings) as server:
        assert_problem(httpx.get(f"{server.address}/models", timeout=30), 401, "unauthorized")
        assert httpx.get(f"{server.address}/health/ready", timeout=30).status_code == 200
        with connect(server.address) as link:
            link.sendall(half_of_a_request(f"Authorization: Bearer {key}", "X-Request-ID: slow"))
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
    lines = [json.loads(line) for line in server.log.read_text().splitlines()]
    (slow,) = (line for line in lines if line.get("request_id") == "slow")
    assert (slow["status"], slow["client"], slow["n"], slow["model"]) == (200, "robot", 3, "pretrained/0")
    assert key not in server.log.read_text()


def test_what_is_in_flight_when_the_grace_is_over_is_told_so(
    tmp_path: Path, bundles: dict[str, Path]
) -> None:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"]), "CSPACE_API_GRACE_S": "1"}
    with server_process(tmp_path, settings) as server, connect(server.address) as link:
        link.sendall(half_of_a_request("X-Request-ID: cut"))
        until(lambda: metric(server.address, "cspace_requests_in_flight") > 1)
        server.process.terminate()
        answer = everything(link)
        start, _, body = answer.partition(b"\r\n\r\n")
        assert start.startswith(b"HTTP/1.1 503 ")
        assert b"\r\nx-request-id: cut" in start
        assert json.loads(body)["type"] == "urn:cspace-sampler:problem:shutting-down"
        assert server.process.wait(10) == 0


def a_plan(time_limit_s: float) -> bytes:
    """Of the shipped arm, for as many paths as there may be."""
    fields: dict[str, object] = {
        "image": [base64.b64encode(one).decode() for one in IMAGES],
        "camera": CAMERAS,
    }
    fields |= {"start": STATE, "goal": [STATE[0] + 1.2, *STATE[1:]], "ways": 64, "time_limit_s": time_limit_s}
    body = json.dumps(fields | {"model": "pretrained-panda"}).encode()
    return head("POST", "/plan", "Content-Type: application/json", f"Content-Length: {len(body)}") + body


def test_a_search_ends_when_its_client_has_gone_and_the_next_one_is_answered(tmp_path: Path) -> None:
    with server_process(tmp_path, {"CSPACE_API_THREADS": "1"}) as server:
        with connect(server.address) as link:
            # Until the search is loaded.
            link.settimeout(120)
            link.sendall(a_plan(0.5))
            assert one_answer(link).startswith(b"HTTP/1.1 200 ")
        with connect(server.address) as link:
            link.sendall(a_plan(10.0))
            until(lambda: metric(server.address, "cspace_requests_in_flight") > 1)
        left_s = until(lambda: metric(server.address, "cspace_requests_in_flight") == 1)
        with connect(server.address) as link:
            link.sendall(a_plan(0.5))
            assert one_answer(link).startswith(b"HTTP/1.1 200 ")
    lines = [json.loads(line) for line in server.log.read_text().splitlines()]
    plans = [line for line in lines if line.get("route") == "/plan"]
    assert [line.get("reason") for line in plans] == [None, "client-gone", None]
    assert left_s < 5.0


@contextmanager
def collector() -> Iterator[tuple[str, list[Span]]]:
    """Its address, and the spans that have come so far."""
    got: list[Span] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
                got.extend(span for scope in resource.scope_spans for span in scope.spans)
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", got
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def test_a_request_is_a_span_under_the_clients_own_and_whoever_only_watches_is_none(
    tmp_path: Path, png: bytes, bundles: dict[str, Path]
) -> None:
    with collector() as (address, spans):
        settings = {
            "CSPACE_PRETRAINED_MODEL": str(bundles["shipped"]),
            "OTEL_EXPORTER_OTLP_ENDPOINT": address,
        }
        with server_process(tmp_path, settings) as server:
            headers = {"traceparent": f"00-{TRACE}-{PARENT}-01"}
            answer = httpx.post(f"{server.address}/sample", files={"image": png}, headers=headers)
            assert answer.status_code == 200
            assert httpx.get(f"{server.address}/metrics").status_code == 200
    # What was still waiting is sent at the end.
    assert [(span.name, span.trace_id.hex(), span.parent_span_id.hex()) for span in spans] == [
        ("POST /sample", TRACE, PARENT)
    ]
