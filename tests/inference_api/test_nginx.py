"""The documented proxy before a real API: what it lets through, and what it keeps from it."""

import json
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest

from inference_api.limits import MAX_BODY_BYTES
from tests.inference_api.answers import IMAGE, PNG
from tests.inference_api.proxy import NAME, Proxy, nginx_before, nginx_of_the_stack
from tests.inference_api.raw import PATIENCE_S, head, metric, one_answer
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.e2e, pytest.mark.slow]

CONNECTIONS = 32
BODY = json.dumps({"image": IMAGE, "n": 3}).encode()
BEHIND = {"CSPACE_API_HOSTS": NAME, "CSPACE_API_TRUSTED_PROXIES": "127.0.0.1"}
FIELDS = ("Content-Type: application/json", f"Content-Length: {len(BODY)}")


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("api")
    guide = folder / "guide"
    guide.mkdir()
    (guide / "index.html").write_text("<h1>the guide</h1>")
    settings = {
        **BEHIND,
        "CSPACE_PRETRAINED_MODEL": str(bundles["plain"]),
        "CSPACE_API_GUIDE": str(guide),
    }
    with api_server(folder, settings) as found:
        yield found


@pytest.fixture
def proxy(api: str, tmp_path: Path) -> Iterator[Proxy]:
    with nginx_before(api, tmp_path) as found:
        yield found


def slow_head() -> bytes:
    return head("POST", "/sample", *FIELDS).replace(b"localhost", NAME.encode()) + BODY[:9]


def test_samples_through_the_proxy_are_those_of_the_api(api: str, proxy: Proxy) -> None:
    fields = {"n": "300", "seed": "7"}
    direct = httpx.post(f"{api}/sample", files={"image": PNG}, data=fields, timeout=30).json()
    with proxy.client() as client:
        answer = proxy.ask(client, "POST", "/sample", files={"image": PNG}, data=fields)
        assert answer.status_code == 200
        assert answer.json()["samples"] == direct["samples"]
        assert answer.headers["strict-transport-security"]
        assert answer.headers["cache-control"] == "no-store"
        pages = ("/models", "/health/ready", "/docs", "/openapi.json", "/docs/assets/favicon.png")
        for path in (*pages, "/guide/", "/"):
            assert proxy.ask(client, "GET", path).status_code == 200
        assert proxy.ask(client, "GET", "/guide").headers["location"] == "guide/"
        own = {"origin": f"https://{NAME}"}
        assert proxy.ask(client, "GET", "/models", headers=own).status_code == 200


def test_pages_that_are_not_for_everybody_and_other_names_do_not_reach_the_api(proxy: Proxy) -> None:
    # As bytes, for a client makes other paths of some of them.
    for path in (
        "/metrics",
        "/metrics/",
        "/nothing",
        "/sample2",
        "//metrics",
        "/docs/../metrics",
        "/docs/%2e%2e/metrics",
    ):
        with proxy.connect() as link:
            link.sendall(head("GET", path).replace(b"localhost", NAME.encode()))
            assert one_answer(link).startswith(b"HTTP/1.1 404 ")
    with proxy.client() as client:
        assert proxy.ask(client, "GET", "/models", headers={"host": "evil.example"}).status_code == 421
    with pytest.raises(ssl.SSLError, match=r"(?i)unrecognized.name"):
        proxy.connect("evil.example")


def test_a_body_that_is_too_large_is_refused_by_the_proxy(api: str, proxy: Proxy) -> None:
    before = httpx.get(f"{api}/metrics").text.count("413")
    with proxy.connect() as link:
        length = f"Content-Length: {MAX_BODY_BYTES + 1}"
        link.sendall(head("POST", "/sample", length).replace(b"localhost", NAME.encode()))
        assert one_answer(link).startswith(b"HTTP/1.1 413 ")
    assert httpx.get(f"{api}/metrics").text.count("413") == before


def test_a_slow_body_takes_no_place_of_the_api_s(api: str, proxy: Proxy) -> None:
    with ExitStack() as stack:
        links = [stack.enter_context(proxy.connect()) for _ in range(CONNECTIONS - 1)]
        for link in links:
            link.sendall(slow_head())
        with proxy.client() as client:
            assert proxy.ask(client, "GET", "/models").status_code == 200
        # The scrape alone.
        assert metric(api, "cspace_requests_in_flight") == 1
        links[0].sendall(BODY[9:])
        assert one_answer(links[0]).startswith(b"HTTP/1.1 200 ")


def test_connections_are_bounded_by_address(proxy: Proxy) -> None:
    with ExitStack() as stack:
        for _ in range(CONNECTIONS):
            stack.enter_context(proxy.connect()).sendall(slow_head())
        with proxy.client() as same, proxy.client("127.0.0.2") as other:
            assert proxy.ask(other, "GET", "/models").status_code == 200
            assert proxy.ask(same, "GET", "/models").status_code == 429


def test_the_stacks_edge_passes_samples_and_pages_on_with_the_name_and_port_that_were_asked_for(
    api: str, tmp_path: Path
) -> None:
    with nginx_of_the_stack("edge.conf", ("http://inference-api:8000", api), tmp_path) as edge:
        own = {"origin": edge}
        answer = httpx.post(f"{edge}/sample", files={"image": PNG}, data={"n": "3"}, headers=own, timeout=30)
        assert answer.status_code == 200
        assert httpx.get(f"{edge}/").status_code == 200
        assert httpx.get(f"{edge}/metrics").status_code == 404
        assert httpx.get(f"{edge}/models", headers={"host": "evil.example"}).status_code == 400
        with socket.create_connection(("127.0.0.1", int(edge.rpartition(":")[2])), PATIENCE_S) as link:
            link.sendall(head("POST", "/sample", f"Content-Length: {MAX_BODY_BYTES + 1}"))
            assert one_answer(link).startswith(b"HTTP/1.1 413 ")


class Mlflow(BaseHTTPRequestHandler):
    """A tracking server that says what it was asked."""

    def do_GET(self) -> None:
        said = f"{self.command} {self.path} {self.headers['Host']}".encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(said)))
        self.end_headers()
        self.wfile.write(said)

    do_POST = do_PUT = do_DELETE = do_PATCH = do_GET  # noqa: N815

    def log_message(self, *arguments: object) -> None:
        """Nothing is written."""


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Mlflow) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        here = f"http://127.0.0.1:{server.server_port}"
        with nginx_of_the_stack("mlflow-reader.conf", ("http://mlflow:5000", here), tmp_path) as found:
            yield found
        server.shutdown()


def test_the_apis_view_of_mlflow_reads_writes_nothing_and_has_no_pages(reader: str) -> None:
    for path in (
        "/api/2.0/mlflow/registered-models/alias?name=a&alias=champion",
        "/api/2.0/mlflow/model-versions/search?filter=name%3D%27a%27",
        "/api/2.0/mlflow-artifacts/artifacts?path=1%2Fmodels",
        "/api/2.0/mlflow-artifacts/artifacts/1/models/m-1/artifacts/bundle/spec.json",
    ):
        assert httpx.get(reader + path).text == f"GET {path} mlflow:5000"
        for method in ("POST", "PUT", "PATCH", "DELETE"):
            assert httpx.request(method, reader + path).status_code == 403
    assert httpx.post(f"{reader}/health").status_code == 403
    for path in ("/", "/graphql", "/ajax-api/2.0/mlflow/runs/get", "/api/3.0/mlflow/traces"):
        assert httpx.get(reader + path).status_code == 403
