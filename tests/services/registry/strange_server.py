"""Servers that are not what an MLflow client hopes for."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

PROBE = "/api/2.0/mlflow/registered-models/search"


@contextmanager
def strange_server(status: int, body: bytes, *, probe_is_well: bool = False) -> Iterator[str]:
    """Answers everything the same way.

    Args:
        status: of every answer.
        body: of every answer.
        probe_is_well: answer the question whether the server is there as MLflow does.
    """

    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length") or 0))
            well = probe_is_well and self.path.startswith(PROBE)
            self.send_response(200 if well else status)
            text = b"{}" if well else body
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)

        do_GET = do_POST = do_PUT = do_PATCH = do_DELETE = answer  # noqa: N815

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
