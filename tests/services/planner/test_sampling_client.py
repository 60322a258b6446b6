"""What the client sends, and what it makes of answers; answers that can not be used: test_hostile_server."""

import httpx
import numpy as np
import pytest

from cspace.errors import (
    ConfigError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from services.planner.client import RetryPolicy, SamplingClient
from tests.fakes.sample_server import npy, read_form, sample_server
from tests.fakes.sample_source import FakeSampleSource
from tests.services.planner.hostile_server import GOOD_HEADERS

PNG = b"\x89PNG picture"
SEED = 2**64 - 1
BELOW_PI = np.nextafter(np.float32(np.pi), np.float32(0))
GOOD = np.array([[0.5, -BELOW_PI], [BELOW_PI, 1.0]], dtype=np.float32)


def client_of(*answers, url="http://test:1", sent=None):
    """A client whose requests get answers in order, the last one again and again, or raise them."""
    left = list(answers)

    def handle(request: httpx.Request) -> httpx.Response:
        request.read()
        if sent is not None:
            sent.append(request)
        answer = left.pop(0) if len(left) > 1 else left[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    policy = RetryPolicy(attempts=1)
    return SamplingClient(url, policy=policy, transport=httpx.MockTransport(handle))


def answer_of(samples=GOOD, **headers):
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return httpx.Response(200, headers={**GOOD_HEADERS, "X-Seed": str(SEED), **named}, content=npy(samples))


def test_a_good_answer_becomes_a_batch():
    batch = client_of(answer_of()).sample(PNG, 2, seed=SEED)
    assert np.array_equal(batch.samples, GOOD)
    assert (batch.model_name, batch.model_version, batch.digest) == ("cspace-sampler", 3, "ab" * 32)
    assert (batch.seed, batch.shortfall, batch.novelty, batch.acceptance) == (SEED, 0, None, None)
    batch = client_of(answer_of(X_Novelty="0.25", X_Acceptance="0.5")).sample(PNG, 2, seed=SEED)
    assert (batch.novelty, batch.acceptance) == (0.25, 0.5)


def test_a_batch_from_which_all_samples_were_dropped_is_empty():
    batch = client_of(answer_of(np.empty((0, 2), np.float32), X_Shortfall="5")).sample(PNG, 5, seed=SEED)
    assert batch.samples.shape == (0, 2)
    assert batch.shortfall == 5


def test_fields_are_sent_as_the_contract_has_them():
    sent = []
    with client_of(answer_of(), answer_of(), url="http://test:1/", sent=sent) as client:
        client.sample(
            PNG,
            2,
            model="cspace-sampler@challenger",
            seed=SEED,
            epsilon_sigma=(0.0, 0.25),
            start=np.array([0.5, 1.0]),
            goal=[-1.0, 2.0],
            min_confidence=0.8,
        )
        client.sample(PNG, 2, seed=SEED)
    request = sent[0]
    fields, second = (read_form(one.headers["content-type"], one.content) for one in sent)
    assert (request.method, str(request.url)) == ("POST", "http://test:1/sample")
    assert request.headers["accept"].startswith("application/x-npy")
    assert fields == {
        "image": [PNG],
        "n": [b"2"],
        "model": [b"cspace-sampler@challenger"],
        "seed": [b"18446744073709551615"],
        "epsilon_sigma": [b"0.0", b"0.25"],
        "start": [b"[0.5, 1.0]"],
        "goal": [b"[-1.0, 2.0]"],
        "min_confidence": [b"0.8"],
    }
    assert set(second) == {"image", "n", "seed"}


def test_an_address_s_name_and_password_are_sent():
    sent = []
    client_of(answer_of(), url="http://me:s3cret@test:1", sent=sent).sample(PNG, 2, seed=SEED)
    assert sent[0].headers["authorization"] == "Basic bWU6czNjcmV0"
    assert sent[0].headers["host"] == "test:1"


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
def test_the_model_that_answers_is_the_one_that_was_asked(model, name, version, fits):
    client = client_of(answer_of(X_Model_Name=name, X_Model_Version=str(version)))
    if fits:
        batch = client.sample(PNG, 2, model=model, seed=SEED)
        assert (batch.model_name, batch.model_version) == (name, version)
    else:
        with pytest.raises(SamplerAnswerError, match="another model"):
            client.sample(PNG, 2, model=model, seed=SEED)


def test_a_problem_s_own_words_reach_the_message():
    problem = {"type": "urn:x:unknown-model", "title": "No such model", "detail": "got nobody/1; see /models"}
    refused = httpx.Response(404, json=problem, headers={"Content-Type": "application/problem+json"})
    with pytest.raises(SamplerModelError) as caught:
        client_of(refused).sample(PNG, 2, seed=SEED)
    assert not isinstance(caught.value, SamplerUnavailableError)
    assert all(value in str(caught.value) for value in problem.values())


@pytest.mark.parametrize(
    "content", [b"{not json", b"[" * 100_000, b'["a list"]', b'{"title": 3, "detail": null}']
)
def test_a_refusal_without_words_is_told_by_its_status(content):
    answer = httpx.Response(422, content=content, headers={"Content-Type": "application/problem+json"})
    with pytest.raises(SamplerError, match="422"):
        client_of(answer).sample(PNG, 2, seed=SEED)


@pytest.mark.parametrize(
    "error",
    [httpx.ConnectError("refused"), httpx.PoolTimeout("late"), httpx.DecodingError("not gzip")],
    ids=lambda error: type(error).__name__,
)
def test_no_error_of_httpx_leaks(error):
    with pytest.raises(SamplerUnavailableError, match="http://test:1") as caught:
        client_of(error).sample(PNG, 2, seed=SEED)
    assert caught.value.__cause__ is error


@pytest.mark.parametrize("url", ["localhost:8000", "ftp://x", "http://", "http://x/?q=1", "http://[::1"])
def test_an_address_that_can_not_be_is_named(url):
    with pytest.raises(ConfigError, match="address"):
        SamplingClient(url)


@pytest.mark.parametrize("timeout_s", [0.0, float("nan"), float("inf")])
def test_a_time_limit_that_can_not_be_is_named(timeout_s):
    with pytest.raises(ConfigError, match="time limit"):
        SamplingClient("http://x", timeout_s)


def test_the_environment_s_proxy_is_not_asked(monkeypatch):
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    with sample_server(FakeSampleSource()) as server, SamplingClient(server.url) as client:
        assert len(client.sample(PNG, 3).samples) == 3


def test_a_client_that_is_closed_asks_no_more():
    client = client_of(answer_of())
    client.close()
    with pytest.raises(RuntimeError, match="closed"):
        client.sample(PNG, 2, seed=SEED)
