"""Keys, limits and headers before the pages of an app in this process."""

import asyncio
import re
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import httpx
import pytest
from starlette.responses import PlainTextResponse
from starlette.types import Message, Receive, Scope, Send

from inference_api.keys import digest_of
from inference_api.limits import SECURITY_HEADERS, Limits, TokenBuckets, client_of
from inference_api.routes.documentation import policy
from inference_api.settings import Protection
from inference_api.telemetry import Metrics, Telemetry
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi, api_over

KEY = "csk_for-this-test"
BEARER = {"authorization": f"Bearer {KEY}"}
PAGES = (
    "/models",
    "/v2/models/pretrained",
    "/metrics",
    "/docs",
    "/openapi.json",
    "/docs/assets/swagger-ui.css",
    "/guide/",
    "/nothing",
)


@pytest.fixture(scope="module")
def keys_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("keys") / "keys"
    path.touch(0o600)
    path.write_text(f"other:{digest_of('csk_another')}\nrobot:{digest_of(KEY)}\n")
    return path


@pytest.fixture(scope="module")
def locked(
    tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path], keys_file: Path
) -> Iterator[ApiClient]:
    protection = Protection(keys_file=keys_file)
    with api_over(tmp_path_factory.mktemp("locked"), bundles, None, protection=protection) as client:
        yield client


def test_every_page_but_health_needs_a_key(locked: ApiClient) -> None:
    for path in PAGES:
        answer = locked.get(path)
        if path.startswith("/v2"):
            assert (answer.status_code, set(answer.json())) == (401, {"error"})
        else:
            assert_problem(answer, 401, "unauthorized")
        assert answer.headers["www-authenticate"] == 'Bearer realm="cspace-sampler"'
        status = 404 if path in ("/nothing", "/guide/") else 200
        assert locked.get(path, headers=BEARER).status_code == status, path
    for path in ("/health/live", "/health/ready", "/v2/health/live", "/v2/health/ready"):
        assert locked.get(path).status_code == 200, path


def test_samples_need_a_key_and_the_body_of_a_stranger_is_not_read(locked: ApiClient) -> None:
    read = []

    async def body() -> AsyncIterator[bytes]:
        read.append(1)
        yield b"{}"

    refused = locked._call(lambda: locked._client.post("/sample", content=body()))
    assert_problem(refused, 401, "unauthorized")
    assert not read
    answer = locked.post("/sample", files={"image": PNG}, data={"n": "3"}, headers=BEARER)
    assert answer.status_code == 200


def test_no_way_of_writing_a_path_goes_round_the_key(locked: ApiClient) -> None:
    detours = ("/health/../models", "/health/live/../../models", "//models", "/health/ready/", "/Health/live")
    for path in detours:
        assert locked.get(f"http://localhost{path}").status_code == 401, path


def test_a_wrong_key_is_401_and_is_not_repeated(locked: ApiClient) -> None:
    for token in ("wrong", KEY + "x", KEY[:-1], digest_of(KEY), "robot", "%00", "é"):
        answer = locked.get("/models", headers={"authorization": f"Bearer {token}".encode()})
        assert_problem(answer, 401, "unauthorized")
        assert 'error="invalid_token"' in answer.headers["www-authenticate"]
        assert token not in answer.json()["detail"]


def test_a_place_is_free_again_after_a_failure() -> None:
    async def scenario() -> list[int]:
        async def fail(scope: Scope, receive: Receive, send: Send) -> None:
            raise ZeroDivisionError

        transport = httpx.ASGITransport(Limits(fail, Protection(max_in_flight=1)), raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return [(await client.get("/")).status_code for _ in range(3)]

    assert asyncio.run(scenario()) == [500, 500, 500]


def test_a_client_above_its_rate_is_429_and_health_does_not_count(start_api: StartApi) -> None:
    api = start_api(protection=Protection(rate_per_s=0.001, rate_burst=2))
    assert [api.get("/models").status_code for _ in range(2)] == [200, 200]
    answer = api.get("/models")
    assert_problem(answer, 429, "too-many-requests")
    assert 1 <= int(answer.headers["retry-after"]) <= 1000
    assert api.get("/health/ready").status_code == 200
    assert api.get("/metrics").status_code == 200


def test_each_key_has_a_rate_of_its_own(start_api: StartApi, keys_file: Path) -> None:
    api = start_api(protection=Protection(keys_file=keys_file, rate_per_s=0.001, rate_burst=1))
    other = {"authorization": "Bearer csk_another"}
    statuses = [api.get("/models", headers=headers).status_code for headers in (BEARER, BEARER, other)]
    assert statuses == [200, 429, 200]


def test_a_bucket_gives_its_burst_then_its_rate_and_never_more_than_the_burst() -> None:
    now = 0.0
    buckets = TokenBuckets(2.0, 3, clock=lambda: now)
    assert [buckets.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert buckets.take("b") == 0.0
    now = 0.25
    assert buckets.take("a") == 0.25
    now = 0.5
    assert [buckets.take("a") for _ in range(2)] == [0.0, 0.5]
    now = 100.0
    assert [buckets.take("a") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]


def test_the_clients_that_are_remembered_are_bounded_and_the_oldest_goes_first() -> None:
    buckets = TokenBuckets(1.0, 1, capacity=2, clock=lambda: 0.0)
    assert [buckets.take(client) for client in "abab"] == [0.0, 0.0, 1.0, 1.0]
    assert buckets.take("c") == 0.0
    assert len(buckets) == 2
    assert (buckets.take("b"), buckets.take("a")) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("192.0.2.1", "192.0.2.2", False),
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("testclient", "testclient", True),
        ("192.0.2.1", "::ffff:192.0.2.1", True),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.2", False),
        ("192.0.2.1", "64:ff9b::192.0.2.1", True),
        ("2002:c000:201::1", "2002:c000:201:ffff::1", True),
        ("fe80::1%eth0", "fe80::2%eth1", True),
    ],
)
def test_addresses_of_one_subscriber_are_one_client(first: str, second: str, same: bool) -> None:
    assert (client_of({"client": (first, 1)}) == client_of({"client": (second, 2)})) is same


def test_a_byte_now_and_then_does_not_lengthen_the_time_of_a_body(start_api: StartApi) -> None:
    api = start_api(protection=Protection(body_timeout_s=0.1))

    async def trickling() -> AsyncIterator[bytes]:
        for _ in range(100):
            yield b" "
            await asyncio.sleep(0.02)

    answer = api._call(
        lambda: api._client.post("/sample", content=trickling(), headers={"content-type": "application/json"})
    )
    assert_problem(answer, 408, "request-timeout")
    assert answer.headers["connection"] == "close"
    assert api.post("/sample", files={"image": PNG}).status_code == 200


ANSWERS = {"/health/live": 200, "/models": 200, "/metrics": 200, "/nothing": 404, "/sample": 405}


def test_every_answer_has_the_security_headers(api: ApiClient) -> None:
    for path, status in ANSWERS.items():
        answer = api.get(path)
        assert answer.status_code == status
        assert {name: answer.headers.get(name) for name in SECURITY_HEADERS} == SECURITY_HEADERS


def test_samples_and_refusals_are_not_to_be_stored(api: ApiClient, locked: ApiClient) -> None:
    answers = [
        api.post("/sample", files={"image": PNG}),
        api.post("/sample", files={"image": PNG}, headers={"accept": "application/x-npy"}),
        api.post("/sample", files={"image": b"no PNG"}),
        locked.get("/models"),
    ]
    assert [answer.status_code for answer in answers] == [200, 200, 422, 401]
    for answer in answers:
        assert answer.headers["cache-control"] == "no-store"
        assert answer.headers["x-content-type-options"] == "nosniff"


def test_the_documentation_may_run_its_own_script_and_no_other(api: ApiClient) -> None:
    sent = api.get("/docs")
    given = dict(part.split(" ", 1) for part in sent.headers["content-security-policy"].split("; "))
    assert given["default-src"] == "'none'"
    assert re.fullmatch(r"'self' 'sha256-[A-Za-z0-9+/]{43}='", given["script-src"])
    assert "unsafe" not in given["script-src"]
    assert policy(sent.content) == sent.headers["content-security-policy"]
    changed = sent.content.replace(b"SwaggerUIBundle(", b"alert(")
    assert changed != sent.content
    assert policy(changed) != policy(sent.content)


@pytest.mark.parametrize("length", ["0" * 5000, "0" * 5000 + "1", "9" * 5000])
def test_a_length_of_thousands_of_digits_is_told_as_what_it_is(length: str) -> None:
    """Below the app: a server's parser may be of any kind."""
    sent: list[Message] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        await PlainTextResponse("in")(scope, receive, send)

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        return {"type": "http.request"}

    scope = {
        "type": "http",
        "path": "/",
        "headers": [(b"content-length", length.encode())],
        "client": ("127.0.0.1", 1),
    }
    asyncio.run(Limits(app, Protection())(scope, receive, send))
    assert sent[0]["status"] == (413 if "9" in length else 200)


def test_a_request_that_is_cancelled_is_answered_and_stays_cancelled() -> None:
    sent: list[Message] = []

    async def waiting(scope: Scope, receive: Receive, send: Send) -> None:
        await asyncio.Event().wait()

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        return {"type": "http.request"}

    scope = {"type": "http", "path": "/", "method": "GET", "headers": []}

    async def scenario() -> None:
        task = asyncio.ensure_future(Telemetry(waiting, Metrics(lambda: None), ())(scope, receive, send))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()

    asyncio.run(scenario())
    assert sent[0]["status"] == 503
