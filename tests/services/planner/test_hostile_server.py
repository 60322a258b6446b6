"""Both HTTP clients against a server that means ill or is broken, over real sockets."""

import socket
import time
import tracemalloc

import pytest

from cspace.errors import SamplerAnswerError, SamplerError, SamplerUnavailableError
from services.planner.client import RetryPolicy
from services.planner.samples import SampleBatch
from tests.fakes.sample_source import DIGEST, FakeSampleSource
from tests.services.planner.clients import KINDS, ask
from tests.services.planner.hostile_answers import ANSI, ATTACKS, BODIES, ENDLESS, problem
from tests.services.planner.hostile_server import SEED, N, hostile_server, plays, whole

PNG = b"\x89PNG picture"
DEADLINE_S = 0.2
# What a busy machine may add.
MARGIN_S = 3.0
POLICY = RetryPolicy(attempts=2, base_s=0.01, cap_s=0.02, deadline_s=DEADLINE_S)
OPTIONS = {"timeout_s": 10.0, "policy": POLICY}

kinds = pytest.mark.parametrize("kind", KINDS)
attacks = pytest.mark.parametrize("name", ATTACKS)


def asked(kind: str, url: str, **options: object) -> SampleBatch:
    return ask(kind, url, PNG, N, options=OPTIONS | options, seed=SEED)


def test_the_good_answer_that_attacks_are_made_of_is_good() -> None:
    with hostile_server(plays(whole())) as server:
        for kind in KINDS:
            batch = asked(kind, server.url)
            assert (batch.samples.shape, batch.seed, batch.fallback) == ((N, 2), SEED, False)


@kinds
@attacks
def test_whatever_comes_the_fallback_answers_within_the_deadline(kind: str, name: str) -> None:
    with hostile_server(ATTACKS[name]) as server:
        began = time.monotonic()
        batch = asked(kind, server.url, fallback=FakeSampleSource())
        assert time.monotonic() - began < DEADLINE_S + MARGIN_S
    assert (batch.fallback, batch.digest, batch.seed) == (True, DIGEST, SEED)


@kinds
@attacks
def test_whatever_comes_the_error_is_of_the_one_tree_and_can_be_printed(kind: str, name: str) -> None:
    with hostile_server(ATTACKS[name]) as server, pytest.raises(SamplerUnavailableError) as caught:
        asked(kind, server.url)
    told = str(caught.value)
    assert told.isprintable()
    assert len(told) < 1500


@kinds
@pytest.mark.parametrize("name", BODIES)
def test_a_body_that_is_no_array_of_samples_is_an_answer_that_can_not_be_used(kind: str, name: str) -> None:
    with hostile_server(BODIES[name]) as server, pytest.raises(SamplerAnswerError, match="answer"):
        asked(kind, server.url)


@kinds
@pytest.mark.parametrize("name", ENDLESS)
def test_an_answer_without_end_takes_no_memory_to_speak_of(kind: str, name: str) -> None:
    with hostile_server(ENDLESS[name]) as server:
        tracemalloc.start()
        try:
            with pytest.raises(SamplerUnavailableError):
                asked(kind, server.url)
            _, peak_bytes = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert peak_bytes < 16 * 2**20


@kinds
@pytest.mark.parametrize("name", ["body: no number", "head: another seed", "endless: tiny chunks"])
def test_no_request_follows_on_the_connection_of_an_answer_that_was_refused(kind: str, name: str) -> None:
    with hostile_server(ATTACKS[name]) as server:
        ask(kind, server.url, PNG, N, times=3, options=OPTIONS | {"fallback": FakeSampleSource()}, seed=SEED)
    assert (server.connections, len(server.heads)) == (3, 3)


@kinds
@pytest.mark.parametrize(
    "content", [whole(), problem("422 No", {"title": "A field is wrong"})], ids=["samples", "refusal"]
)
def test_connections_of_whole_answers_go_on_being_used(kind: str, content: bytes) -> None:
    def question() -> None:
        ask(kind, server.url, PNG, N, times=5, options=OPTIONS, seed=SEED)

    with hostile_server(plays(content)) as server:
        if b"422" in content:
            with pytest.raises(SamplerError, match="A field is wrong"):
                question()
        else:
            question()
            assert (server.connections, len(server.heads)) == (1, 5)


@kinds
@pytest.mark.parametrize("status", ["400", "401", "403", "404", "405", "413", "415", "422", "451"])
def test_a_refusal_of_the_request_is_the_caller_s_affair_and_no_fallback_s(kind: str, status: str) -> None:
    source = FakeSampleSource()
    answer = problem(f"{status} No", {"title": ANSI, "detail": "why"})
    with hostile_server(plays(answer)) as server, pytest.raises(SamplerError, match="why") as caught:
        asked(kind, server.url, fallback=source)
    assert not isinstance(caught.value, SamplerUnavailableError)
    assert str(caught.value).isprintable()
    assert source.requests == []


@kinds
def test_a_server_that_takes_a_request_byte_by_byte_is_left_at_the_deadline(kind: str) -> None:
    def sips(link: socket.socket) -> None:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        until = time.monotonic() + 20.0
        while time.monotonic() < until and link.recv(512):
            time.sleep(0.01)

    with hostile_server(sips, reads=False) as server:
        began = time.monotonic()
        picture = b"\x89PNG" + b"\0" * 2**24
        batch = ask(
            kind, server.url, picture, N, options=OPTIONS | {"fallback": FakeSampleSource()}, seed=SEED
        )
        assert time.monotonic() - began < DEADLINE_S + MARGIN_S
    assert batch.fallback


@kinds
def test_a_handshake_that_drips_is_left_at_the_deadline(kind: str) -> None:
    def drips(link: socket.socket) -> None:
        link.sendall(b"\x16\x03\x03\x40\x00\x02\x00\x3f\xfc\x03\x03")
        until = time.monotonic() + 20.0
        while time.monotonic() < until:
            link.sendall(b"\0")
            time.sleep(0.02)

    with hostile_server(drips, reads=False) as server:
        url = server.url.replace("http://", "https://")
        began = time.monotonic()
        assert asked(kind, url, fallback=FakeSampleSource()).fallback
        assert time.monotonic() - began < DEADLINE_S + MARGIN_S


@kinds
@pytest.mark.parametrize(
    ("model", "name", "version", "fits"),
    [
        (None, "anything", 4, True),
        ("pretrained", "pretrained", 0, True),
        ("pretrained", "cspace-sampler", 3, False),
        ("cspace-sampler", "cspace-sampler", 3, True),
        ("cspace-sampler", "pretrained", 0, True),
        ("cspace-sampler", "pretrained", 3, False),
        ("cspace-sampler", "other", 3, False),
        ("cspace-sampler@champion", "cspace-sampler", 3, True),
        ("cspace-sampler@champion", "pretrained", 0, False),
        ("cspace-sampler/3", "cspace-sampler", 3, True),
        ("cspace-sampler/3", "cspace-sampler", 4, False),
        ("cspace-sampler/3", "pretrained", 0, False),
    ],
)
def test_the_model_that_answers_is_the_one_that_was_asked(
    kind: str, model: str | None, name: str, version: int, fits: bool
) -> None:
    answer = whole(X_Model_Name=name, X_Model_Version=str(version))
    with hostile_server(plays(answer)) as server:
        if fits:
            batch = ask(kind, server.url, PNG, N, options=OPTIONS, seed=SEED, model=model)
            assert (batch.model_name, batch.model_version) == (name, version)
        else:
            with pytest.raises(SamplerAnswerError, match="another model"):
                ask(kind, server.url, PNG, N, options=OPTIONS, seed=SEED, model=model)


@kinds
def test_a_stranger_s_cookies_are_not_kept(kind: str) -> None:
    with hostile_server(plays(whole(Set_Cookie="a=b; Path=/"))) as server:
        ask(kind, server.url, PNG, N, times=2, options=OPTIONS, seed=SEED)
    assert [b"cookie" in head.lower() for head in server.heads] == [False, False]


@kinds
def test_an_answer_is_asked_for_as_it_is_unpacked(kind: str) -> None:
    with hostile_server(plays(whole())) as server:
        asked(kind, server.url)
    assert b"accept-encoding: identity\r\n" in server.heads[0].lower()
