"""What both HTTP clients do while the server is not as it should be: the same tests for both."""

import socket
from collections.abc import Callable
from pathlib import Path

import anyio
import httpx
import numpy as np
import pytest

from cspace.errors import ConfigError, SamplerError, SamplerUnavailableError
from cspace.png import encode_png
from cspace_client import client as clients
from cspace_client.transport import LIMITS, DeadlineTransport
from services.planner.client import ClientSource, RetryPolicy, SamplingClient
from services.planner.samples import LocalSampler, SampleBatch
from tests.bundles import picture, write_tiny_bundle
from tests.fakes.async_client import AsyncSamplingClient
from tests.fakes.sample_server import npy, read_form, sample_server
from tests.fakes.sample_source import DIGEST, FakeSampleSource
from tests.services.planner.hostile_server import GOOD_HEADERS

PNG = encode_png(picture())
SAMPLES = np.zeros((2, 2), np.float32)
POLICY = RetryPolicy(attempts=3, base_s=0.1, cap_s=1.0, deadline_s=20.0)


def good() -> httpx.Response:
    return httpx.Response(200, headers=GOOD_HEADERS, content=npy(SAMPLES))


class Client:
    """A client over answers in order, with what it sent and how long it would have paused."""

    def __init__(self, kind: str, pauses: list[float]) -> None:
        self.kind, self.pauses = kind, pauses
        self.requests: list[httpx.Request] = []

    def __call__(self, *answers: httpx.Response | Exception, **options: object) -> SampleBatch:
        left = list(answers)

        def handle(request: httpx.Request) -> httpx.Response:
            request.read()
            self.requests.append(request)
            answer = left.pop(0)
            if isinstance(answer, Exception):
                raise answer
            if answer.status_code == 200:
                form = read_form(request.headers["content-type"], request.content)
                answer.headers["X-Seed"] = form["seed"][0].decode()
            return answer

        transport = httpx.MockTransport(handle)
        return self.over("http://test:1", policy=POLICY, transport=transport, **options)

    def over(self, url: str, **options: object) -> SampleBatch:
        if self.kind == "sync":
            with SamplingClient(url, **options) as client:
                return client.sample(PNG, 2)

        async def ask() -> SampleBatch:
            async with AsyncSamplingClient(url, **options) as client:
                return await client.sample(PNG, 2)

        return anyio.run(ask)


@pytest.fixture(params=["sync", "async"])
def ask(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Client:
    pauses: list[float] = []

    async def pause(seconds: float) -> None:
        pauses.append(seconds)

    class Time:
        sleep = staticmethod(pauses.append)
        perf_counter = staticmethod(clients.time.perf_counter)

    class Anyio:
        sleep = staticmethod(pause)
        fail_after = staticmethod(anyio.fail_after)
        to_thread = anyio.to_thread

    monkeypatch.setattr(clients, "time", Time)
    monkeypatch.setattr(clients, "anyio", Anyio)
    return Client(request.param, pauses)


AGAIN: dict[str, Callable[[], httpx.Response | Exception]] = {
    "503": lambda: httpx.Response(503),
    "429": lambda: httpx.Response(429),
    "502": lambda: httpx.Response(502),
    "408": lambda: httpx.Response(408),
    "refused": lambda: httpx.ConnectError("refused"),
    "no connection in time": lambda: httpx.ConnectTimeout("late"),
    "reset": lambda: httpx.ReadError("reset"),
    "closed while idle": lambda: httpx.RemoteProtocolError("closed"),
}


@pytest.mark.parametrize("name", AGAIN)
def test_what_may_pass_is_tried_again_as_the_same_request(ask: Client, name: str) -> None:
    batch = ask(AGAIN[name](), AGAIN[name](), good())
    assert np.array_equal(batch.samples, SAMPLES)
    assert batch.fallback is False
    forms = [read_form(request.headers["content-type"], request.content) for request in ask.requests]
    assert len(forms) == 3
    assert forms[0] == forms[1] == forms[2]
    assert 0 <= int(forms[0]["seed"][0]) < 2**64
    assert 0.0 <= ask.pauses[0] < 0.1
    assert 0.0 <= ask.pauses[1] < 0.2


@pytest.mark.parametrize("name", ["503", "refused"])
def test_the_last_failure_is_told_when_all_attempts_are_spent(ask: Client, name: str) -> None:
    with pytest.raises(SamplerUnavailableError):
        ask(*(AGAIN[name]() for _ in range(3)))
    assert (len(ask.requests), len(ask.pauses)) == (3, 2)


@pytest.mark.parametrize(
    "answer",
    [(422, False), (401, False), (500, True), (504, True), (200, True), (302, True)],
    ids=["wrong", "no key", "failed", "gateway is late", "no array", "elsewhere"],
)
def test_what_will_come_again_is_not_tried_again(ask: Client, answer: tuple[int, bool]) -> None:
    status, as_good_as_none = answer
    with pytest.raises(SamplerError) as caught:
        ask(httpx.Response(status, content=b"?"))
    assert isinstance(caught.value, SamplerUnavailableError) == as_good_as_none
    assert (len(ask.requests), ask.pauses) == (1, [])


def test_a_server_that_works_too_long_is_not_given_the_work_again(ask: Client) -> None:
    with pytest.raises(SamplerUnavailableError, match="in time"):
        ask(httpx.ReadTimeout("late"))
    assert len(ask.requests) == 1


def test_retry_after_is_honoured_up_to_the_deadline(ask: Client) -> None:
    ask(httpx.Response(429, headers={"Retry-After": "3"}), good())
    assert ask.pauses == [3.0]
    with pytest.raises(SamplerUnavailableError):
        ask(httpx.Response(503, headers={"Retry-After": "20"}))
    assert (len(ask.requests), len(ask.pauses)) == (3, 1)


def test_two_drawn_seeds_differ(ask: Client) -> None:
    ask(good())
    ask(good())
    seeds = [read_form(one.headers["content-type"], one.content)["seed"] for one in ask.requests]
    assert seeds[0] != seeds[1]


def test_the_key_is_sent_and_never_told(ask: Client) -> None:
    ask(good(), api_key="s3cret")
    ask(good())
    assert [one.headers.get("authorization") for one in ask.requests] == ["Bearer s3cret", None]
    for wrong in ("", "s3cret s3cret", "s3cret\n", "s3crét"):
        with pytest.raises(ConfigError) as caught:
            ask(good(), api_key=wrong)
        assert not wrong or "s3cr" not in str(caught.value)


def test_connecting_and_reading_have_time_limits_of_their_own(ask: Client) -> None:
    ask(good(), timeout_s=9.0, connect_timeout_s=0.5)
    ask(good(), timeout_s=60.0)
    first, second = (one.extensions["timeout"] for one in ask.requests)
    assert (first["connect"], first["read"], first["write"]) == (0.5, 9.0, 9.0)
    # Within the deadline of 20 s.
    assert 0.0 < second["read"] <= 20.0
    with pytest.raises(ConfigError, match="time limit"):
        ask(good(), connect_timeout_s=0.0)


def test_the_fallback_answers_with_the_same_seed_while_the_server_is_away(ask: Client) -> None:
    source = FakeSampleSource()
    batch = ask(*(httpx.Response(503) for _ in range(3)), fallback=ClientSource(source))
    assert (batch.fallback, batch.digest, len(batch.samples)) == (True, DIGEST, 2)
    sent = read_form(ask.requests[0].headers["content-type"], ask.requests[0].content)
    assert str(source.requests[0].query.seed).encode() == sent["seed"][0]
    assert source.requests[0].image_png == PNG


def test_the_fallback_is_not_asked_when_the_server_refuses_or_answers(ask: Client) -> None:
    source = FakeSampleSource()
    assert ask(good(), fallback=ClientSource(source)).fallback is False
    with pytest.raises(SamplerError, match="422"):
        ask(httpx.Response(422), fallback=ClientSource(source))
    assert source.requests == []


def test_a_fallback_that_has_no_answer_leaves_the_server_s_absence_to_be_told(ask: Client) -> None:
    with pytest.raises(SamplerUnavailableError, match="503"):
        ask(*(httpx.Response(503) for _ in range(3)), fallback=ClientSource(FakeSampleSource(ready=False)))


def test_a_bundle_stands_in_for_a_server_that_is_not_there(ask: Client, tmp_path: Path) -> None:
    local = LocalSampler(write_tiny_bundle(tmp_path / "bundle"))
    batch = ask.over("http://127.0.0.1:9", policy=POLICY, fallback=ClientSource(local))
    again = local.sample(PNG, 2, seed=batch.seed)
    assert batch.fallback
    assert np.array_equal(batch.samples, again.samples)
    assert again.fallback is False


def test_small_packets_are_not_held_back_on_the_real_socket() -> None:
    seen: list[int] = []

    class Watched(DeadlineTransport):
        def handle_request(self, request: httpx.Request) -> httpx.Response:
            answer = super().handle_request(request)
            link = answer.extensions["network_stream"].get_extra_info("socket")
            seen.append(link.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            return answer

    with (
        sample_server(FakeSampleSource()) as server,
        SamplingClient(server.url, transport=Watched(LIMITS)) as client,
    ):
        client.sample(PNG, 2)
    assert [bool(value) for value in seen] == [True]


def test_tasks_share_an_awaited_client_and_requests_a_connection() -> None:
    async def work(url: str) -> None:
        async with AsyncSamplingClient(url) as client:
            for seed in range(4):
                await client.sample(PNG, 3, seed=seed)
            async with anyio.create_task_group() as tasks:
                for _ in range(4):
                    tasks.start_soon(client.sample, PNG, 3)

    with sample_server(FakeSampleSource()) as server:
        anyio.run(work, server.url)
    assert len(set(server.connections[:4])) == 1
    assert len(server.connections) == 8
