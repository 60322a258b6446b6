"""Names under which the server answers, pages that may use it, and how much requests may take."""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Annotated

import httpx
import pytest
from fastapi import Depends, FastAPI
from starlette.types import Message, Receive, Scope, Send

from inference_api import limits
from inference_api.limits import ComputePlace, ComputePlaces, LimitRequests
from inference_api.problems import add_problem_handlers
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi, api_over

SITE = "https://site.example"


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    hosts = ("api.example", "[2001:db8::1]")
    folder = tmp_path_factory.mktemp("named")
    with api_over(folder, bundles, None, api_hosts=hosts, api_origins=(SITE,)) as client:
        yield client


KNOWN = (
    "localhost", "localhost:8000", "LOCALHOST", "127.0.0.1:1", "[::1]", "[::1]:80", "API.example:443",
    "[2001:DB8::1]",
)  # fmt: skip
UNKNOWN = (
    "evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "evil.example:8000", "", ":80",
    "[::2]", "[::1", "localhost@evil.example", "api.example.", "10.0.0.1",
)  # fmt: skip


def test_known_names_are_answered_with_any_port_and_others_are_refused(named: ApiClient) -> None:
    for host in KNOWN:
        assert named.get("/models", headers={"host": host}).status_code == 200, host
    for path, hosts in (
        ("/models", UNKNOWN),
        *((one, UNKNOWN[:1]) for one in ("/nothing", "/docs", "/metrics")),
    ):
        for host in hosts:
            answer = named.get(path, headers={"host": host})
            assert answer.status_code == 400, host
            assert "x-request-id" in answer.headers
    for path in ("/health/live", "/health/ready"):
        assert named.get(path, headers={"host": "localhost:8000", "origin": "null"}).status_code == 200


def test_a_star_answers_under_any_name(start_api: StartApi) -> None:
    api = start_api(api_hosts=("*",))
    assert api.get("/models", headers={"host": "any.example"}).status_code == 200


CASES = [
    ("GET", {}, 200),
    ("GET", {"origin": "HTTP://LOCALHOST:8000"}, 200),
    ("GET", {"origin": SITE, "sec-fetch-site": "cross-site"}, 200),
    ("GET", {"origin": "http://localhost:8001"}, 403),
    ("GET", {"origin": "https://localhost:8000"}, 403),
    ("GET", {"origin": "http://localhost:8000.evil.example"}, 403),
    ("GET", {"origin": f"{SITE}.evil.example"}, 403),
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
    host = {"host": "localhost:8000"}
    if method == "POST":
        answer = named.post("/sample", files={"image": PNG}, headers={**host, **headers})
    else:
        answer = named.get("/models", headers={**host, **headers})
    assert answer.status_code == status
    if status == 403:
        assert_problem(answer, 403, "foreign-origin")


def test_a_page_of_an_allowed_site_asks_and_reads_the_answer(named: ApiClient) -> None:
    site = {"host": "localhost:8000", "origin": SITE}
    wish = {"access-control-request-method": "POST", "access-control-request-headers": "authorization"}
    preflight = named.options("/sample", headers=site | wish)
    assert preflight.status_code == 200
    assert "POST" in preflight.headers["access-control-allow-methods"]
    for answer in (preflight, named.post("/sample", files={"image": PNG}, headers=site)):
        assert answer.headers["access-control-allow-origin"] == SITE
    other = site | wish | {"origin": "https://other.example"}
    assert named.options("/sample", headers=other).status_code == 403


def test_a_byte_now_and_then_does_not_lengthen_the_time_of_a_body(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "BODY_TIMEOUT_S", 0.1)
    api = start_api()

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


def test_one_client_takes_neither_all_places_nor_all_bytes_and_gives_back_what_it_held() -> None:
    inside = asyncio.Event()

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        await inside.wait()
        raise ZeroDivisionError

    async def scenario() -> list[int]:
        limited = LimitRequests(app, 4)

        async def ask(host: str) -> int:
            transport = httpx.ASGITransport(limited, raise_app_exceptions=False, client=(host, 1))
            async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
                answer = await client.get("/")
            if answer.status_code == 503:
                assert_problem(answer, 503, "overloaded")
                assert answer.headers["retry-after"] == "1"
            return answer.status_code

        held = [asyncio.create_task(ask("192.0.2.1")) for _ in range(3)]
        await asyncio.sleep(0.05)
        statuses = [await ask("192.0.2.1")]
        held.append(asyncio.create_task(ask("192.0.2.2")))
        await asyncio.sleep(0.05)
        statuses.append(await ask("192.0.2.3"))
        inside.set()
        return statuses + await asyncio.gather(*held) + [await ask("192.0.2.1") for _ in range(3)]

    assert asyncio.run(scenario()) == [503, 503] + [500] * 4 + [500] * 3


class Computing:
    """An app whose one route computes until the test lets it go, and asks its place now and then."""

    def __init__(self, cores: int) -> None:
        self.free, self.running, self.ended = threading.Event(), 0, list[str]()
        self.app = FastAPI()
        self.app.state.places = ComputePlaces(cores)
        add_problem_handlers(self.app)
        self.app.add_middleware(LimitRequests, max_in_flight=64)

        @self.app.post("/plan")
        @self.app.post("/")
        def compute(body: Annotated[bytes, Depends(_read)], place: ComputePlace) -> str:
            self.running += 1
            try:
                while not self.free.is_set():
                    place.check_cancelled()
                    time.sleep(0.001)
            except Exception as error:
                self.ended.append(type(error).__name__)
                raise
            finally:
                self.running -= 1
            return "computed"

    async def ask(self, host: str, path: str = "/") -> int:
        transport = httpx.ASGITransport(self.app, client=(host, 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return (await client.post(path, content=b"body", timeout=None)).status_code

    async def leave(self) -> None:
        """A client that goes away once its body is there."""
        messages = [{"type": "http.request", "body": b"body"}]

        async def receive() -> Message:
            if messages:
                return messages.pop()
            await asyncio.sleep(0.1)
            return {"type": "http.disconnect"}

        async def send(message: Message) -> None:
            """Nobody reads it."""

        scope = {"type": "http", "path": "/", "method": "POST", "headers": [], "query_string": b""}
        await self.app(scope | {"client": ("192.0.2.9", 1)}, receive, send)

    async def settled(self) -> int:
        await asyncio.sleep(0.2)
        return self.running


async def _read(request: limits.Request) -> bytes:
    return await request.body()


def test_a_client_never_holds_the_last_place_to_compute() -> None:
    computing = Computing(3)

    async def scenario() -> None:
        first = [asyncio.create_task(computing.ask("192.0.2.1")) for _ in range(5)]
        assert await computing.settled() == 2
        others = [asyncio.create_task(computing.ask(f"192.0.2.{number}")) for number in (2, 3)]
        assert await computing.settled() == 3
        computing.free.set()
        assert set(await asyncio.gather(*first, *others)) == {200}

    asyncio.run(scenario())


def test_searches_of_many_clients_leave_a_place_for_samples() -> None:
    computing = Computing(2)

    async def scenario() -> None:
        plans = [asyncio.create_task(computing.ask(f"192.0.2.{number}", "/plan")) for number in range(4)]
        assert await computing.settled() == 1
        sample = asyncio.create_task(computing.ask("192.0.2.9"))
        assert await computing.settled() == 2
        computing.free.set()
        assert set(await asyncio.gather(sample, *plans)) == {200}

    asyncio.run(scenario())


def test_what_nobody_waits_for_any_more_stops_and_gives_its_place_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    computing = Computing(1)

    async def scenario() -> None:
        # One computes and one waits for its place; both leave.
        await asyncio.gather(computing.leave(), computing.leave())
        assert computing.ended == ["ClientDisconnect"]
        monkeypatch.setattr(limits, "ANSWER_S", 0.2)
        assert await asyncio.gather(computing.ask("a"), computing.ask("b")) == [503, 503]
        assert set(computing.ended[1:]) == {"RequestError"}
        computing.free.set()
        assert await computing.ask("c") == 200

    asyncio.run(scenario())
