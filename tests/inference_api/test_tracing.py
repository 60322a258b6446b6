"""Traces of a real process, as a collector on a real socket gets them."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import ResourceSpans, Span

from cspace.errors import ConfigError
from inference_api.tracing import otlp_provider
from tests.inference_api.server import server_process

TRACE, PARENT = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"


@contextmanager
def collector() -> Iterator[tuple[str, list[ResourceSpans]]]:
    """Its address, and what has come so far."""
    got: list[ResourceSpans] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            got.extend(ExportTraceServiceRequest.FromString(body).resource_spans)
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


def attributes(span: Span) -> dict[str, object]:
    return {one.key: getattr(one.value, str(one.value.WhichOneof("value"))) for one in span.attributes}


@pytest.mark.e2e
def test_a_request_is_one_trace_with_its_stages_under_the_clients_own_span(
    tmp_path: Path, png: bytes, bundles: dict[str, Path]
) -> None:
    with collector() as (address, got):
        settings = {
            "CSPACE_PRETRAINED_MODEL": str(bundles["shipped"]),
            "OTEL_EXPORTER_OTLP_ENDPOINT": address,
            "OTEL_SERVICE_NAME": "lab-7",
        }
        with server_process(tmp_path, settings) as server:
            headers = {"traceparent": f"00-{TRACE}-{PARENT}-01", "X-Request-ID": "robot-1.7"}
            data = {"n": "5", "seed": str(2**64 - 1)}
            answer = httpx.post(f"{server.address}/sample", files={"image": png}, data=data, headers=headers)
            assert answer.status_code == 200
            assert httpx.post(f"{server.address}/sample", content=b"x").status_code == 415
            assert httpx.get(f"{server.address}/metrics").status_code == 200
        # What was still waiting is sent at the end.
        spans = [span for one in got for scope in one.scope_spans for span in scope.spans]
    services = {
        str(a.value.string_value) for one in got for a in one.resource.attributes if a.key == "service.name"
    }
    assert services == {"lab-7"}
    (served,) = [span for span in spans if span.parent_span_id.hex() == PARENT]
    assert served.trace_id.hex() == TRACE
    values = attributes(served)
    assert values["cspace.request_id"] == "robot-1.7"
    assert (values["cspace.model"], values["cspace.seed"]) == ("pretrained/0", str(2**64 - 1))
    stages = [span for span in spans if span.parent_span_id == served.span_id]
    assert [span.name for span in stages] == ["decode", "encode", "generate"]
    assert all(served.start_time_unix_nano <= span.start_time_unix_nano for span in stages)
    assert all(span.end_time_unix_nano <= served.end_time_unix_nano for span in stages)
    # Whoever only watches is not traced.
    roots = [attributes(span) for span in spans if span not in (served, *stages)]
    assert [root.get("http.status_code", root.get("http.response.status_code")) for root in roots] == [415]


def test_without_the_packages_the_error_tells_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry.exporter.otlp.proto.http.trace_exporter", None)
    with pytest.raises(ConfigError, match=r"cspace-sampler\[tracing\]"):
        otlp_provider()
