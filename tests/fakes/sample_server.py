"""A small HTTP server that speaks the sampling endpoint's contract over any source of samples."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from email import policy
from email.parser import BytesParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from cspace.errors import SamplerError, SamplerUnavailableError
from cspace.query import PLAIN, SampleQuery
from services.planner.samples import SampleBatch, SampleSource

Answer = tuple[int, dict[str, str], bytes]


def read_form(content_type: str, body: bytes) -> dict[str, list[bytes]]:
    """The parts of a multipart form by name."""
    head = f"Content-Type: {content_type}\r\n\r\n".encode()
    fields: dict[str, list[bytes]] = {}
    for part in BytesParser(policy=policy.HTTP).parsebytes(head + body).iter_parts():
        name = str(part.get_param("name", header="content-disposition"))
        fields.setdefault(name, []).append(part.get_payload(decode=True))
    return fields


def ask(source: SampleSource, fields: dict[str, list[bytes]]) -> SampleBatch:
    """The fields of a form as a call of the source."""
    text = {name: values[0].decode() for name, values in fields.items() if name != "image"}
    query = SampleQuery.checked(
        int(text["n"]),
        int(text["seed"]),
        epsilon_sigma=[float(value) for value in fields.get("epsilon_sigma", PLAIN)],
        start=json.loads(text.get("start", "null")),
        goal=json.loads(text.get("goal", "null")),
        min_confidence=float(text["min_confidence"]) if "min_confidence" in text else None,
        robot=text.get("robot"),
    )
    return source.answer(fields["image"][0], query, text.get("model"))


def sample_answer(samples: object, seed: int = 7, **changes: Any) -> bytes:
    """A good answer of `POST /sample` but for the changes; members of `model` may be given by their name."""
    rows = np.asarray(samples, np.float32)
    model = {"name": "cspace-sampler", "version": 3, "digest": "ab" * 32, "robot": None}
    body = {
        "samples": rows.tolist(),
        "confidence": None,
        "shortfall": 0,
        "acceptance": 1.0,
        "scenario": {"novelty": None},
        "warnings": [],
        "joint_space": {"kind": "torus", "dim": 2, "unit": "rad"},
        "model": model | {name: changes.pop(name) for name in list(changes) if name in model},
        "seed": str(seed),
        "timing_ms": dict.fromkeys(("decode", "encode", "generate", "total"), 1.0),
    }
    return json.dumps(body | changes).encode()


def batch_answer(batch: SampleBatch) -> Answer:
    """200 with a batch."""
    headers = {"Content-Type": "application/json", "X-Request-ID": "request-1"}
    model = {"name": batch.model_name, "version": batch.model_version, "digest": batch.digest}
    shown = None if batch.confidence is None else batch.confidence.tolist()
    body = sample_answer(batch.samples, batch.seed, shortfall=batch.shortfall, confidence=shown, **model)
    return 200, headers, body


def problem_answer(status: int, error: SamplerError) -> Answer:
    """An error as RFC 9457 problem details."""
    problem = {
        "type": "urn:test:unknown-model" if status == 404 else f"urn:test:{status}",
        "title": error.what,
        "status": status,
        "detail": str(error),
    }
    return status, {"Content-Type": "application/problem+json"}, json.dumps(problem).encode()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    source: SampleSource
    connections: list[tuple[str, int]]

    def do_POST(self) -> None:
        self.connections.append(self.client_address)
        body = self.rfile.read(int(self.headers["Content-Length"]))
        assert self.path == "/sample"
        try:
            answer = batch_answer(ask(self.source, read_form(self.headers["Content-Type"], body)))
        except SamplerUnavailableError as error:
            answer = problem_answer(503, error)
        except SamplerError as error:
            answer = problem_answer(404 if "model" in error.what else 422, error)
        status, headers, content = answer
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


class SampleServer:
    """A running server.

    Args:
        url: where it listens.
        connections: the peer of each request, in order.
    """

    def __init__(self, url: str, connections: list[tuple[str, int]]) -> None:
        self.url, self.connections = url, connections


@contextmanager
def sample_server(source: SampleSource) -> Iterator[SampleServer]:
    """Serve a source on a free loopback port."""
    connections: list[tuple[str, int]] = []
    handler = type("Handler", (_Handler,), {"source": source, "connections": connections})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield SampleServer(f"http://127.0.0.1:{server.server_port}", connections)
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
