"""Both HTTP clients against a server that means ill or is broken, over real sockets."""

import socket
import time
import tracemalloc

import pytest

from cspace.errors import SamplerAnswerError, SamplerError, SamplerUnavailableError
from services.planner.client import ClientSource, RetryPolicy
from services.planner.samples import SampleBatch
from tests.fakes.sample_source import DIGEST, FakeSampleSource
from tests.services.planner.clients import KINDS, ask
from tests.services.planner.hostile_answers import ANSI, ATTACKS, problem
from tests.services.planner.hostile_server import SEED, N, Script, hostile_server, plays, whole

PNG = b"\x89PNG picture"
DEADLINE_S = 0.2
# What a busy machine may add.
MARGIN_S = 3.0
HASTY, PATIENT = (
    RetryPolicy(2, base_s=0.01, cap_s=0.02, deadline_s=limit_s) for limit_s in (DEADLINE_S, 20.0)
)
# Whole answers are read by the same code in both clients; what arrives and when is each one's own affair.
CASES = [("sync", name) for name in ATTACKS if not name.startswith("endless")]
CASES += [("async", name) for name in ATTACKS if name.startswith(("never done", "broken"))]

kinds = pytest.mark.parametrize("kind", KINDS)


def sampled(kind: str, url: str, png: bytes = PNG, times: int = 1, **options: object) -> SampleBatch:
    policy = {"timeout_s": 10.0, "policy": PATIENT}
    return ask(kind, url, png, N, times=times, options=policy | options, seed=SEED)


def policy_for(name: str) -> RetryPolicy:
    """Only what has an end may take its time."""
    return HASTY if name.startswith(("endless", "never done")) else PATIENT


def refused(kind: str, name: str) -> None:
    """An attack is an error of the one tree, in time, that can be printed."""
    expected = SamplerAnswerError if name.startswith("body") else SamplerUnavailableError
    with hostile_server(ATTACKS[name]) as server:
        began = time.monotonic()
        with pytest.raises(expected) as caught:
            sampled(kind, server.url, policy=policy_for(name))
        assert time.monotonic() - began < DEADLINE_S + MARGIN_S
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 1500


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_whatever_comes_the_error_is_of_the_one_tree_and_can_be_printed(kind: str, name: str) -> None:
    refused(kind, name)


@kinds
@pytest.mark.parametrize("name", [name for name in ATTACKS if name.startswith("endless")])
def test_an_answer_without_end_takes_no_memory_to_speak_of(kind: str, name: str) -> None:
    tracemalloc.start()
    try:
        refused(kind, name)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 16 * 2**20


@kinds
@pytest.mark.parametrize(
    "name",
    [
        *("endless: tiny chunks", "never done: silence", "body: no number", "head: another seed"),
        *("status: a failure", "words: control characters", "broken: a reset"),
    ],
)
def test_whatever_comes_the_fallback_answers_within_the_deadline(kind: str, name: str) -> None:
    with hostile_server(ATTACKS[name]) as server:
        began = time.monotonic()
        batch = sampled(kind, server.url, policy=policy_for(name), fallback=ClientSource(FakeSampleSource()))
        assert time.monotonic() - began < DEADLINE_S + MARGIN_S
    assert (batch.fallback, batch.digest, batch.seed) == (True, DIGEST, SEED)


@kinds
@pytest.mark.parametrize("name", ["body: no number", "head: another seed", "endless: tiny chunks"])
def test_no_request_follows_on_the_connection_of_an_answer_that_was_refused(kind: str, name: str) -> None:
    with hostile_server(ATTACKS[name]) as server:
        sampled(kind, server.url, times=3, fallback=ClientSource(FakeSampleSource()))
    assert (server.connections, len(server.heads)) == (3, 3)


@kinds
def test_connections_of_whole_answers_go_on_being_used_for_bodies_as_they_are_and_without_cookies(
    kind: str,
) -> None:
    with hostile_server(plays(whole(Set_Cookie="a=b; Path=/"))) as server:
        batch = sampled(kind, server.url, times=5)
    assert (batch.samples.shape, batch.seed, batch.fallback) == ((N, 2), SEED, False)
    assert (server.connections, len(server.heads)) == (1, 5)
    for head in server.heads:
        assert b"cookie" not in head.lower()
        assert b"accept-encoding: identity\r\n" in head.lower()


@pytest.mark.parametrize(
    ("kind", "status"),
    [*(("sync", status) for status in ("400", "401", "404", "413", "422", "451")), ("async", "422")],
)
def test_a_refusal_of_the_request_is_the_caller_s_affair_and_no_fallback_s(kind: str, status: str) -> None:
    source = FakeSampleSource()
    answer = problem(f"{status} No", {"title": ANSI, "detail": "why"})
    with hostile_server(plays(answer)) as server, pytest.raises(SamplerError, match="why") as caught:
        sampled(kind, server.url, fallback=ClientSource(source))
    assert not isinstance(caught.value, SamplerUnavailableError)
    assert str(caught.value).isprintable()
    assert source.requests == []


def sips(link: socket.socket) -> None:
    """Takes a request byte by byte."""
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    until = time.monotonic() + 20.0
    while time.monotonic() < until and link.recv(512):
        time.sleep(0.01)


def drips(link: socket.socket) -> None:
    """Sends a handshake byte by byte."""
    link.sendall(b"\x16\x03\x03\x40\x00\x02\x00\x3f\xfc\x03\x03")
    until = time.monotonic() + 20.0
    while time.monotonic() < until:
        link.sendall(b"\0")
        time.sleep(0.02)


@kinds
@pytest.mark.parametrize(
    ("script", "scheme", "png"),
    [(sips, "http", b"\x89PNG" + b"\0" * 2**24), (drips, "https", PNG)],
    ids=["request", "handshake"],
)
def test_a_request_or_a_handshake_that_never_ends_is_left_at_the_deadline(
    kind: str, script: Script, scheme: str, png: bytes
) -> None:
    with hostile_server(script, reads=False) as server:
        began = time.monotonic()
        url = server.url.replace("http", scheme)
        assert sampled(kind, url, png, policy=HASTY, fallback=ClientSource(FakeSampleSource())).fallback
        assert time.monotonic() - began < DEADLINE_S + MARGIN_S
