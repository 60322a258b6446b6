"""The documented proxy before a real API: what it lets through, and what it keeps from it."""

import json
import ssl
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from inference_api.guards.body_limit import MAX_BODY_BYTES
from tests.inference_api.answers import IMAGE, PNG
from tests.inference_api.proxy import NAME, Proxy, nginx_before
from tests.inference_api.raw import head, metric, one_answer
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
        pages = ("/models", "/v2", "/health/ready", "/docs", "/openapi.json", "/docs/assets/favicon.png")
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


def test_a_forged_address_does_not_change_the_bucket(tmp_path: Path, bundles: dict[str, Path]) -> None:
    limited = {"CSPACE_API_RATE": "0.001", "CSPACE_API_BURST": "3"}
    settings = {**BEHIND, **limited, "CSPACE_PRETRAINED_MODEL": str(bundles["plain"])}
    with api_server(tmp_path, settings) as api, nginx_before(api, tmp_path) as proxy:
        with proxy.client() as client:
            answers = [
                proxy.ask(client, "GET", "/models", headers={"x-forwarded-for": f"192.0.2.{number}"})
                for number in range(5)
            ]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429, 429]
        assert answers[-1].json()["type"] == "urn:cspace-sampler:problem:too-many-requests"
        with proxy.client("127.0.0.2") as client:
            assert proxy.ask(client, "GET", "/models").status_code == 200
