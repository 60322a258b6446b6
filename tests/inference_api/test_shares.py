"""Places that are shared out among clients."""

import asyncio

import httpx
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from inference_api.limits import Limits, Shares
from inference_api.settings import Protection
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.conftest import StartApi


def test_a_client_alone_gets_three_of_four_places() -> None:
    for limit, alone in ((1, 1), (2, 2), (3, 3), (4, 3), (64, 48), (1024, 768)):
        shares = Shares(limit)
        taken = [shares.take("a") for _ in range(limit + 1)]
        assert taken.count(None) == alone
        assert taken[-1] == ("server" if alone == limit else "client")


def test_each_further_client_finds_room_and_what_is_given_back_is_free() -> None:
    shares = Shares(64)
    held = dict.fromkeys("abcdefgh", 0)
    for client in held:
        while shares.take(client) is None:
            held[client] += 1
    assert held["a"] == 48
    assert [held[client] >= 1 for client in "abc"] == [True, True, True]
    for client, count in held.items():
        for _ in range(count):
            shares.give(client)
    assert shares.free == 64
    assert [shares.take("a") for _ in range(49)].count(None) == 48


def test_amounts_are_taken_whole_or_not_at_all() -> None:
    shares = Shares(100)
    assert shares.take("a", 101) == "server"
    assert shares.take("a", 75) is None
    assert shares.take("a", 1) == "client"
    assert shares.take("b", 26) == "server"
    assert shares.take("b", 25) is None
    assert shares.free == 0


def test_a_refusal_tells_whose_places_are_full() -> None:
    async def scenario() -> list[str]:
        go, entered = asyncio.Event(), asyncio.Semaphore(0)

        async def slow(scope: Scope, receive: Receive, send: Send) -> None:
            entered.release()
            await go.wait()
            await PlainTextResponse("done")(scope, receive, send)

        app = Limits(slow, Protection(max_in_flight=4))

        def client(host: str) -> httpx.AsyncClient:
            transport = httpx.ASGITransport(app, client=(host, 1))
            return httpx.AsyncClient(transport=transport, base_url="http://localhost")

        async with (
            client("192.0.2.1") as first,
            client("::ffff:192.0.2.1") as same,
            client("192.0.2.2") as other,
        ):
            held = [asyncio.create_task(first.get("/")) for _ in range(3)]
            for _ in held:
                await entered.acquire()
            refused = [await same.get("/")]
            held.append(asyncio.create_task(other.get("/")))
            await entered.acquire()
            refused.append(await other.get("/"))
            watched = [asyncio.create_task(other.get(path)) for path in ("/health/live", "/metrics")]
            # Those who watch the server find room even then.
            for _ in watched:
                await asyncio.wait_for(entered.acquire(), 20.0)
            go.set()
            assert {answer.status_code for answer in await asyncio.gather(*held, *watched)} == {200}
            assert (await first.get("/")).status_code == 200
        for answer in refused:
            assert_problem(answer, 503, "overloaded")
            assert answer.headers["retry-after"] == "1"
        return [answer.json()["detail"] for answer in refused]

    own, all_of_it = asyncio.run(scenario())
    assert own.startswith("this client's share")
    assert all_of_it.startswith("the server is full")


def test_bodies_that_are_held_are_bounded_together_and_let_go_of(start_api: StartApi) -> None:
    api = start_api(protection=Protection(held_body_bytes=2 * len(PNG)))
    for _ in range(4):
        assert api.post("/sample", files={"image": PNG}).status_code == 200
    answer = api.post("/sample", content=[b" " * len(PNG)] * 3, headers={"content-type": "application/json"})
    assert_problem(answer, 503, "overloaded")
    assert answer.headers["retry-after"] == "1"
    assert api.post("/sample", files={"image": PNG}).status_code == 200


def test_a_body_is_let_go_of_when_its_request_fails() -> None:
    async def scenario() -> list[int]:
        async def fail(scope: Scope, receive: Receive, send: Send) -> None:
            await receive()
            raise ZeroDivisionError

        transport = httpx.ASGITransport(
            Limits(fail, Protection(held_body_bytes=20)), raise_app_exceptions=False
        )
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return [(await client.post("/", content=b"x" * 10)).status_code for _ in range(5)]

    assert asyncio.run(scenario()) == [500] * 5
