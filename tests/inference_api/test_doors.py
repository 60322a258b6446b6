"""Names under which the server answers, and pages that may use it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from inference_api.settings import Protection
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi, api_over


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    protection = Protection(
        hosts=("api.example", "[2001:db8::1]"),
        origins=("https://site.example",),
        trusted_proxies=("127.0.0.1",),
    )
    with api_over(tmp_path_factory.mktemp("named"), bundles, None, protection=protection) as client:
        yield client


KNOWN = (
    "localhost", "localhost:8000", "LOCALHOST", "127.0.0.1:1", "[::1]", "[::1]:80", "API.example:443",
    "[2001:DB8::1]",
)  # fmt: skip
UNKNOWN = (
    "evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "evil.example:8000", "", ":80",
    "[::2]", "[::1", "localhost@evil.example", "api.example.", "10.0.0.1",
)  # fmt: skip


def test_known_names_are_answered_with_any_port(named: ApiClient) -> None:
    for host in KNOWN:
        assert named.get("/models", headers={"host": host}).status_code == 200, host


def test_other_names_are_421(named: ApiClient) -> None:
    for path, hosts in (
        ("/models", UNKNOWN),
        *((path, UNKNOWN[:1]) for path in ("/nothing", "/docs", "/metrics")),
    ):
        for host in hosts:
            answer = named.get(path, headers={"host": host})
            assert_problem(answer, 421, "unknown-host")
            assert answer.headers["cache-control"] == "no-store"
            assert "x-request-id" in answer.headers
    answer = named.get("/v2", headers={"host": "evil.example"})
    assert (answer.status_code, set(answer.json())) == (421, {"error"})


def test_a_name_that_is_missing_or_there_twice_is_421(named: ApiClient) -> None:
    twice = named._call(
        lambda: named._client.get("/models", headers=[("host", "localhost"), ("host", "localhost")])
    )
    assert_problem(twice, 421, "unknown-host")

    async def without() -> int:
        request = named._client.build_request("GET", "/models")
        del request.headers["host"]
        return (await named._client.send(request)).status_code

    assert named._portal.call(without) == 421


def test_health_is_answered_under_any_name_for_any_page(named: ApiClient) -> None:
    for path in ("/health/live", "/health/ready", "/v2/health/live"):
        assert named.get(path, headers={"host": "10.1.2.3:8000", "origin": "null"}).status_code == 200


def test_a_star_answers_under_any_name(start_api: StartApi) -> None:
    api = start_api(protection=Protection(hosts=("*",)))
    assert api.get("/models", headers={"host": "any.example"}).status_code == 200
    assert api.get("/models", headers={"host": ""}).status_code == 421


PAGE = {"host": "localhost:8000"}
CASES = [
    ("GET", {}, 200),
    ("GET", {"origin": "http://localhost:8000"}, 200),
    ("GET", {"origin": "HTTP://LOCALHOST:8000"}, 200),
    ("GET", {"origin": "https://site.example"}, 200),
    ("GET", {"origin": "https://site.example", "sec-fetch-site": "cross-site"}, 200),
    ("GET", {"origin": "http://localhost:8001"}, 403),
    ("GET", {"origin": "https://localhost:8000"}, 403),
    ("GET", {"origin": "http://evil.example"}, 403),
    ("GET", {"origin": "null"}, 403),
    ("GET", {"origin": ""}, 403),
    ("GET", {"sec-fetch-site": "same-origin"}, 200),
    ("GET", {"sec-fetch-site": "none"}, 200),
    ("GET", {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, 200),
    ("GET", {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"}, 403),
    ("GET", {"sec-fetch-site": "same-site"}, 403),
    ("POST", {"sec-fetch-site": "same-origin", "origin": "http://localhost:8000"}, 200),
    ("POST", {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, 403),
    ("POST", {"origin": "http://evil.example"}, 403),
]


@pytest.mark.parametrize(("method", "headers", "status"), CASES)
def test_pages_of_other_sites_may_link_here_and_nothing_else(
    named: ApiClient, method: str, headers: dict[str, str], status: int
) -> None:
    if method == "POST":
        answer = named.post("/sample", files={"image": PNG}, headers={**PAGE, **headers})
    else:
        answer = named.get("/models", headers={**PAGE, **headers})
    assert answer.status_code == status
    if status == 403:
        assert_problem(answer, 403, "foreign-origin")


def test_behind_a_trusted_proxy_a_page_of_its_own_scheme_is_its_own(named: ApiClient) -> None:
    headers = {"host": "api.example", "origin": "https://api.example"}
    assert named.get("/models", headers=headers).status_code == 403
    assert named.get("/models", headers={**headers, "x-forwarded-proto": "https"}).status_code == 200


def test_forwarded_addresses_count_behind_trusted_proxies_only(start_api: StartApi) -> None:
    def statuses(api: ApiClient) -> list[int]:
        return [
            api.get("/models", headers={"x-forwarded-for": f"192.0.2.{number}"}).status_code
            for number in range(3)
        ]

    # The client in this process has the address 127.0.0.1.
    limited = Protection(rate_per_s=0.001, rate_burst=1)
    assert statuses(start_api(protection=limited)) == [200, 429, 429]
    trusting = Protection(rate_per_s=0.001, rate_burst=1, trusted_proxies=("127.0.0.0/8",))
    assert statuses(start_api(protection=trusting)) == [200, 200, 200]


def test_a_page_of_an_allowed_site_asks_and_reads_the_answer(named: ApiClient) -> None:
    site = {"host": "localhost:8000", "origin": "https://site.example"}
    wish = {"access-control-request-method": "POST", "access-control-request-headers": "authorization"}
    preflight = named.options("/sample", headers=site | wish)
    assert preflight.status_code == 200
    assert "POST" in preflight.headers["access-control-allow-methods"]
    assert preflight.headers["access-control-allow-headers"] == "authorization"
    for answer in (
        preflight,
        named.post("/sample", files={"image": PNG}, data={"n": "1"}, headers=site),
        named.post("/sample", headers=site),
    ):
        assert answer.headers["access-control-allow-origin"] == "https://site.example"
    own = {"host": "localhost:8000", "origin": "http://localhost:8000"}
    assert "access-control-allow-origin" not in named.get("/models", headers=own).headers
    other = site | wish | {"origin": "https://other.example"}
    assert_problem(named.options("/sample", headers=other), 403, "foreign-origin")
