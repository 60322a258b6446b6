import json
import socket

import httpx
import numpy as np
import pytest

from cspace.errors import ConfigError, CspaceError, SamplerError, SamplerModelError, SamplerUnavailableError
from services.planner.client import SamplingClient
from tests.fakes.sample_server import npy, read_form, sample_server
from tests.fakes.sample_source import FakeSampleSource

PNG = b"\x89PNG picture"
SEED = 2**64 - 1
HEADERS = {
    "Content-Type": "application/x-npy",
    "X-Model-Name": "cspace-sampler",
    "X-Model-Version": "3",
    "X-Model-Digest": "ab" * 32,
    "X-Seed": str(SEED),
    "X-Shortfall": "0",
}
BELOW_PI = np.nextafter(np.float32(np.pi), np.float32(0))
GOOD = np.array([[0.5, -BELOW_PI], [3.0, 1.0]], dtype=np.float32)


def client_of(answer):
    """A client whose every request gets one answer, or raises it."""

    def handle(request: httpx.Request) -> httpx.Response:
        if isinstance(answer, Exception):
            raise answer
        return answer

    return SamplingClient("http://test:1", transport=httpx.MockTransport(handle))


def answer_of(samples=GOOD, **headers):
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    content = samples if isinstance(samples, bytes) else npy(samples)
    return httpx.Response(200, headers={**HEADERS, **named}, content=content)


def test_a_good_answer_becomes_a_batch():
    batch = client_of(answer_of()).sample(PNG, 2, seed=SEED)
    assert np.array_equal(batch.samples, GOOD)
    assert (batch.model_name, batch.model_version, batch.digest) == ("cspace-sampler", 3, "ab" * 32)
    assert (batch.seed, batch.shortfall) == (SEED, 0)


@pytest.mark.parametrize("name", ["novelty", "acceptance"])
def test_novelty_and_acceptance_are_read_where_they_are_told(name):
    assert getattr(client_of(answer_of()).sample(PNG, 2, seed=SEED), name) is None
    told = client_of(answer_of(**{f"X_{name.title()}": "0.25"})).sample(PNG, 2, seed=SEED)
    assert getattr(told, name) == 0.25


@pytest.mark.parametrize("name", ["novelty", "acceptance"])
@pytest.mark.parametrize("value", ["", "new", "nan", "-0.1", "1.5"])
def test_those_that_can_not_be_are_refused(value, name):
    with pytest.raises(SamplerError, match=f"x-{name}"):
        client_of(answer_of(**{f"X_{name.title()}": value})).sample(PNG, 2, seed=SEED)


def test_a_batch_from_which_all_samples_were_dropped_is_empty():
    batch = client_of(answer_of(np.empty((0, 2), np.float32), X_Shortfall="5")).sample(PNG, 5, seed=SEED)
    assert batch.samples.shape == (0, 2)
    assert batch.shortfall == 5


def test_fields_are_sent_as_the_contract_has_them():
    sent = []

    def handle(request: httpx.Request) -> httpx.Response:
        sent.append((request, read_form(request.headers["content-type"], request.read())))
        return answer_of()

    with SamplingClient("http://test:1/", transport=httpx.MockTransport(handle)) as client:
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
    request, fields = sent[0]
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
    assert set(sent[1][1]) == {"image", "n", "seed"}


def test_a_problem_s_own_words_reach_the_message():
    problem = {"type": "urn:x:unknown-model", "title": "No such model", "detail": "got nobody/1; see /models"}
    refused = httpx.Response(404, json=problem, headers={"Content-Type": "application/problem+json"})
    with pytest.raises(SamplerModelError) as caught:
        client_of(refused).sample(PNG, 2, seed=SEED)
    assert not isinstance(caught.value, SamplerUnavailableError)
    assert all(value in str(caught.value) for value in problem.values())


def test_no_model_ready_is_unavailable_with_the_server_s_reason():
    answer = httpx.Response(503, json={"title": "No model is ready", "detail": "train one"})
    with pytest.raises(SamplerUnavailableError, match=r"No model is ready.*train one"):
        client_of(answer).sample(PNG, 2, seed=SEED)


@pytest.mark.parametrize(
    "error",
    [
        httpx.ConnectError("refused"),
        httpx.ConnectTimeout("late"),
        httpx.ReadTimeout("late"),
        httpx.PoolTimeout("late"),
        httpx.ReadError("reset"),
        httpx.RemoteProtocolError("half an answer"),
        httpx.DecodingError("not gzip"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_no_error_of_httpx_leaks(error):
    with pytest.raises(SamplerUnavailableError, match="http://test:1") as caught:
        client_of(error).sample(PNG, 2, seed=SEED)
    assert caught.value.__cause__ is error


@pytest.mark.parametrize(
    ("status", "content", "media_type"),
    [
        (500, b"<html>oops</html>", "text/html"),
        (422, b"{not json", "application/problem+json"),
        (422, b"[" * 100_000, "application/problem+json"),
        (422, b'["a list"]', "application/problem+json"),
        (422, b'{"title": 3, "detail": null}', "application/problem+json"),
        (302, b"", "text/plain"),
        (204, b"", "application/x-npy"),
    ],
)
def test_an_answer_of_another_kind_is_refused_with_its_status(status, content, media_type):
    answer = httpx.Response(status, content=content, headers={"Content-Type": media_type, "Location": "/x"})
    with pytest.raises(SamplerError, match=str(status)):
        client_of(answer).sample(PNG, 2, seed=SEED)


def claim(shape: str, data: bytes = b"\0" * 16, dtype: str = "<f4") -> bytes:
    """A ``.npy`` file whose header says what it likes."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + data


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no array",
        npy(GOOD)[:-1],
        npy(GOOD) + b"\0",
        npy(GOOD.astype(np.float64)),
        npy(GOOD.astype(">f4")),
        npy(GOOD[0]),
        npy(GOOD[None]),
        npy(np.asfortranarray(GOOD)),
        npy(GOOD[:1]),
        npy(np.full((2, 2), np.nan, np.float32)),
        npy(np.full((2, 2), np.inf, np.float32)),
        npy(np.full((2, 2), np.pi, np.float32)),
        claim("(1000000000000, 2)"),
        claim("(-1, -4)"),
        claim("(2, 2)", dtype="|O"),
        claim("(2, 2, __import__('os'))"),
        b"PK\x03\x04" + b"\0" * 60,
    ],
    ids=[
        "nothing",
        "text",
        "cut off",
        "too long",
        "float64",
        "big-endian",
        "flat",
        "cube",
        "by columns",
        "fewer rows",
        "nan",
        "inf",
        "pi",
        "huge claim",
        "negative claim",
        "objects",
        "code",
        "zip",
    ],
)
def test_a_body_that_is_not_the_promised_array_is_an_error(content):
    with pytest.raises(SamplerError, match="answer"):
        client_of(answer_of(content)).sample(PNG, 2, seed=SEED)


def test_the_largest_float32_below_pi_is_an_angle():
    samples = np.full((2, 2), BELOW_PI)
    assert np.array_equal(client_of(answer_of(samples)).sample(PNG, 2, seed=SEED).samples, samples)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("X_Model_Name", ""),
        ("X_Model_Version", "latest"),
        ("X_Model_Digest", ""),
        ("X_Seed", "-1"),
        ("X_Seed", "1" * 5000),
        ("X_Shortfall", "1"),
        ("X_Shortfall", "one"),
        ("Content_Type", "application/json"),
    ],
)
def test_a_header_that_is_missing_or_wrong_is_an_error(name, value):
    with pytest.raises(SamplerError, match="answer"):
        client_of(answer_of(**{name: value})).sample(PNG, 2, seed=SEED)


@pytest.mark.parametrize("url", ["localhost:8000", "ftp://x", "http://", "", "http://x/?q=1", "http://[::1"])
def test_an_address_that_can_not_be_is_named(url):
    with pytest.raises(ConfigError, match="address"):
        SamplingClient(url)


@pytest.mark.parametrize("timeout_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_time_limit_that_can_not_be_is_named(timeout_s):
    with pytest.raises(ConfigError, match="time limit"):
        SamplingClient("http://x", timeout_s)


def test_requests_share_one_connection():
    with sample_server(FakeSampleSource()) as server, SamplingClient(server.url) as client:
        for seed in range(5):
            client.sample(PNG, 3, seed=seed)
    assert len(server.connections) == 5
    assert len(set(server.connections)) == 1


def test_a_server_that_never_answers_is_unavailable_after_the_time_limit():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        client = SamplingClient(url, timeout_s=0.1)
        with client, pytest.raises(SamplerUnavailableError, match=r"0\.1 s"):
            client.sample(PNG, 3)


def test_the_environment_s_proxy_is_not_asked(monkeypatch):
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    with sample_server(FakeSampleSource()) as server, SamplingClient(server.url) as client:
        assert len(client.sample(PNG, 3).samples) == 3


def test_problems_are_errors_of_the_one_tree():
    for status in range(400, 600, 7):
        with pytest.raises(CspaceError):
            client_of(httpx.Response(status, content=json.dumps({"title": "x"}))).sample(PNG, 2, seed=SEED)


def test_a_client_that_is_closed_asks_no_more():
    client = client_of(answer_of())
    client.close()
    with pytest.raises(RuntimeError, match="closed"):
        client.sample(PNG, 2, seed=SEED)


def test_an_address_s_name_and_password_are_sent():
    sent = []

    def handle(request: httpx.Request) -> httpx.Response:
        sent.append(request)
        return answer_of()

    with SamplingClient("http://me:s3cret@test:1", transport=httpx.MockTransport(handle)) as client:
        client.sample(PNG, 2, seed=SEED)
    assert sent[0].headers["authorization"] == "Basic bWU6czNjcmV0"
    assert sent[0].headers["host"] == "test:1"
