"""Which jobs are under way, asked of a head that is a few lines of HTTP."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from services.local.stack import jobs_under_way

JOB = {
    "submission_id": "raysubmit_1",
    "status": "RUNNING",
    "start_time": 1_700_000_000_000,
    "entrypoint": "python training/cluster_train.py --job arm-1",
}


class Head(HTTPServer):
    """Answers what it is told to."""

    content: bytes = b"[]"


@pytest.fixture
def head() -> Iterator[Head]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            allowed = self.path == "/api/jobs/" and self.headers["Authorization"] == "Bearer t"
            self.send_response(200 if allowed else 401)
            self.end_headers()
            self.wfile.write(server.content)

        def log_message(self, *_: Any) -> None:
            """Say nothing."""

    server = Head(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def lines_of(head: Head, key: str = "t") -> tuple[str, ...]:
    return jobs_under_way(f"http://127.0.0.1:{head.server_port}", {"Authorization": f"Bearer {key}"})


def test_jobs_that_run_or_wait_are_told_with_id_time_and_command(head: Head) -> None:
    others = [JOB | {"status": "SUCCEEDED"}, JOB | {"submission_id": None}]
    head.content = json.dumps(
        [JOB, *others, JOB | {"submission_id": "raysubmit_2", "status": "PENDING"}]
    ).encode()
    first, one, two = lines_of(head)
    assert "goes on when it is submitted again" in first
    assert one.startswith("  raysubmit_1, since 2023-11-")
    assert one.endswith(": python training/cluster_train.py --job arm-1")
    assert "raysubmit_2" in two


def test_nothing_is_told_where_nothing_runs_or_nobody_answers(head: Head) -> None:
    head.content = json.dumps([JOB | {"status": "STOPPED"}]).encode()
    assert lines_of(head) == ()
    head.content = json.dumps([JOB]).encode()
    assert lines_of(head, key="wrong") == ()
    for content in (b"{", b"{}", b"[1]", b'[{"submission_id": "a"}]'):
        head.content = content
        assert lines_of(head) == ()
    assert jobs_under_way("http://127.0.0.1:1", {}) == ()
