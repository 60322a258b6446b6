"""The client by itself: what it sends, what it makes of answers, when it asks again."""

import json
import logging
import pickle
from pathlib import Path
from types import SimpleNamespace

import httpx
import numpy as np
import pytest
from pydantic import ValidationError

import cspace_client
from cspace_client import (
    ConfigError,
    DepthPictures,
    Known,
    PlanQuery,
    SampleQuery,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
    SamplingClient,
)
from cspace_client import client as module
from tests.fakes.sample_server import read_form, sample_answer

PNG = b"\x89PNG picture"
ROWS = [[0.5, -3.0], [3.0, 1.0]]


class Server:
    """Gives answers in order, the last one for good, or raises them; keeps requests and forms."""

    def __init__(self, *answers):
        self.left, self.requests = list(answers), []

    def __call__(self, request):
        request.read()
        self.requests.append(request)
        answer = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        if isinstance(answer, Exception):
            raise answer
        # A response is read once.
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    @property
    def forms(self):
        return [read_form(one.headers["content-type"], one.content) for one in self.requests]

    def ask(self, call, **options):
        """A call of a client."""
        with SamplingClient("http://test:1", transport=httpx.MockTransport(self), **options) as client:
            return call(client)


def good(**changes):
    return httpx.Response(200, content=sample_answer(ROWS, **changes), headers={"X-Request-ID": "r-1"})


def sample(client):
    return client.sample(PNG, 2, seed=7)


@pytest.fixture(autouse=True)
def pauses(monkeypatch):
    """The pauses between attempts, which take no time."""
    found = []
    # Of the client alone: other threads of this process go on to sleep.
    monkeypatch.setattr(module, "time", SimpleNamespace(**vars(module.time) | {"sleep": found.append}))
    return found


def test_an_answer_becomes_a_batch_and_its_warnings_are_logged(caplog):
    warning = {"code": "rolled", "message": "the camera is turned", "pictures": [0], "new": True}
    space = {"kind": "mixed", "dim": 2, "unit": "rad", "lower": [-np.pi, -4.0], "upper": [np.pi, 1.0]}
    space["periodic"] = [True, False]
    server = Server(good(warnings=[warning], joint_space=space, confidence=[0.5, 0.75], added="later"))
    with caplog.at_level(logging.WARNING, "cspace_client"):
        batch = server.ask(sample)
    np.testing.assert_array_equal(batch.samples, np.float32(ROWS))
    np.testing.assert_array_equal(batch.confidence, np.float32([0.5, 0.75]))
    assert (batch.model_name, batch.model_version) == ("cspace-sampler", 3)
    assert (batch.seed, batch.request_id) == (7, "r-1")
    assert batch.space == cspace_client.JointSpace((-np.pi, -4.0), (np.pi, 1.0), (True, False))
    assert batch.warnings[0].code == "rolled"
    assert "rolled: the camera is turned" in caplog.text


def test_fields_are_sent_as_the_contract_has_them_and_the_rest_is_left_to_the_server():
    server = Server(good())
    given = {"start": np.array([0.5, 1.0], np.float32), "goal": (-1, 2), "min_confidence": np.float64(0.25)}
    server.ask(
        lambda client: client.sample(
            PNG, np.int64(2), np.uint64(2**64 - 1), model="m@a", epsilon_sigma=np.array([0.0, 0.25]), **given
        ),
        api_key="s3cret",
    )
    server.ask(lambda client: client.sample(PNG, 2), robot="ab" * 32)
    first, second = server.forms
    assert first == {
        "image": [PNG],
        "n": [b"2"],
        "model": [b"m@a"],
        "seed": [b"18446744073709551615"],
        "epsilon_sigma": [b"0.0", b"0.25"],
        "start": [b"[0.5, 1.0]"],
        "goal": [b"[-1.0, 2.0]"],
        "min_confidence": [b"0.25"],
    }
    assert set(second) == {"image", "n", "seed", "robot"}
    keys = [one.headers.get("authorization") for one in server.requests]
    assert keys == ["Bearer s3cret", None]
    pose = {"goal_pose": {"pose": np.eye(4)}, "limits": [(-1, 2.5), None], "keep": True}
    with pytest.raises(SamplerError):
        server.ask(lambda client: client.plan(PNG, PlanQuery(start=[0.0, 1.0], **pose)))
    sent = {name: json.loads(value[0]) for name, value in server.forms[-1].items() if name in pose}
    assert sent == {"goal_pose": {"pose": np.eye(4).tolist()}, "limits": [[-1.0, 2.5], None], "keep": True}


OPENAPI = json.loads(Path(__file__).parents[1].joinpath("inference_api/openapi.json").read_text())
BOX = {"name": "crate", "box": {"size_m": [0.1, 0.1, 0.1]}}
VIEW = {"fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0, "pose": np.eye(4)}
EVERYTHING = DepthPictures(
    [PNG],
    [VIEW],
    [0.0, 0.0],
    depth_scale_m=0.001,
    max_age_s=1.0,
    known=Known([BOX], [BOX], [("crate", "hand")], [BOX], {"a.stl": b"solid"}),
    check_pose=False,
)
# Values of queries that are not the client's to invent.
GIVEN = {
    "goal_pose": {"pose": np.eye(4)},
    "upright": {"axis": [0.0, 0.0, 1.0], "max_rad": 0.1},
    "limits": [None, None],
    "start": [0.0, 0.0],
    "goal": [0.0, 0.0],
    **dict.fromkeys(("min_confidence", "max_risk"), 0.5),
    "max_velocity_rad_s": [1.0, 1.0],
    "max_acceleration_rad_s2": [1.0, 1.0],
}


def full(kind):
    """A query with all of its fields."""
    fields = kind.model_fields.items()
    return kind(**{name: GIVEN.get(name, 1 if name == "seed" else field.default) for name, field in fields})


@pytest.mark.parametrize(
    ("call", "request_schema"),
    [
        (lambda client, **named: client.answer(EVERYTHING, full(SampleQuery), **named), "SampleRequest"),
        (lambda client, **named: client.plan(EVERYTHING, full(PlanQuery), **named), "PlanRequest"),
        (lambda client, **named: client.validity(EVERYTHING, ROWS, explain=True, **named), "ValidityRequest"),
        (lambda client, **named: client.belief(EVERYTHING, **named), "BeliefRequest"),
        (lambda client, **named: client.doctor(EVERYTHING, **named), "DoctorRequest"),
    ],
    ids=["sample", "plan", "validity", "belief", "doctor"],
)
def test_the_client_sends_every_field_that_the_api_takes(call, request_schema):
    server = Server(httpx.Response(422))
    with pytest.raises(SamplerError, match="422"):
        server.ask(lambda client: call(client, model="m", robot="ab" * 32))
    [form] = server.forms
    sent = {"meshes" if name == "mesh" else name for name in form}
    assert sent == set(OPENAPI["components"]["schemas"][request_schema]["properties"])


@pytest.mark.parametrize(
    "wrong",
    [
        {"n": -1}, {"n": "3"}, {"n": True}, {"seed": -1}, {"seed": 0.5}, {"start": [[0.0]]},
        {"goal": [0.0, float("nan")]}, {"epsilon_sigma": ["a"]}, {"min_confidence": 2.0}, {"other": 1},
    ],
    ids=str,
)  # fmt: skip
def test_a_value_that_no_request_has_is_named_before_anything_is_sent(wrong):
    server = Server(good())
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        server.ask(lambda client: client.sample(PNG, **{"n": 2, **wrong}))
    assert server.requests == []


LATER = [
    httpx.ConnectError("refused"),
    httpx.RemoteProtocolError("disconnected"),
    httpx.Response(503),
    httpx.Response(429, headers={"Retry-After": "3"}),
]


@pytest.mark.parametrize("answer", LATER, ids=["refused", "disconnected", "503", "429"])
def test_what_may_pass_is_tried_again_as_the_same_request_and_then_told(answer, pauses):
    server = Server(answer, good())
    assert len(server.ask(lambda client: client.sample(PNG, 2)).samples) == 2
    first, again = server.forms
    assert first == again
    if isinstance(answer, httpx.Response):
        least_s = float(answer.headers.get("retry-after", 0.5))
        assert least_s <= pauses[0] <= 1.2 * least_s
    server = Server(answer)
    with pytest.raises(SamplerUnavailableError):
        server.ask(sample, retries=3)
    assert len(server.requests) == 4


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (httpx.Response(422), SamplerError),
        (httpx.Response(404, json={"type": "urn:x:unknown-model", "title": "No such model", "status": 404,
                                   "detail": "see /models"}), SamplerModelError),
        (httpx.Response(500, content=b"[" * 100_000), SamplerUnavailableError),
        (httpx.Response(501), SamplerUnavailableError),
        (httpx.Response(302), SamplerAnswerError),
        (httpx.Response(200, content=b"<html>"), SamplerAnswerError),
        (httpx.Response(200, content=sample_answer(ROWS, shortfall="many")), SamplerAnswerError),
        (httpx.ReadTimeout("late"), SamplerUnavailableError),
        (httpx.Response(503, headers={"Retry-After": "60"}), SamplerUnavailableError),
    ],
    ids=["refused", "model", "failed", "plans", "elsewhere", "no answer", "wrong", "late", "too late"],
)  # fmt: skip
def test_what_will_come_again_is_told_at_once(answer, error):
    server = Server(answer)
    with pytest.raises(SamplerError) as caught:
        server.ask(sample)
    assert type(caught.value) is error
    assert len(server.requests) == 1


def test_only_what_httpx_raises_for_a_connection_is_called_unreachable():
    for ours in (TypeError("a fault of this program"), httpx.InvalidURL("no")):
        with pytest.raises(type(ours)):
            Server(ours).ask(sample)
    with pytest.raises(SamplerUnavailableError, match=r"http://test:1 cannot be reached.*refused") as caught:
        Server(httpx.ConnectError("refused")).ask(sample)
    assert isinstance(caught.value.__cause__, httpx.ConnectError)


def test_answers_are_bounded_in_size_and_time():
    with pytest.raises(SamplerAnswerError, match="too long"):
        Server(httpx.Response(200, content=bytes(module.MAX_ANSWER_BYTES + 1))).ask(sample)
    with pytest.raises(SamplerUnavailableError, match="in time"):
        Server(good()).ask(sample, deadline_s=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [*({"url": url} for url in ("localhost:8000", "ftp://x", "http://", "http://x/?q=1", "http://[::1")),
     {"timeout_s": 0.0}, {"deadline_s": float("nan")}, {"retries": -1}],
    ids=str,
)  # fmt: skip
def test_an_address_or_a_limit_that_is_impossible_is_named_and_the_error_survives_pickling(wrong):
    with pytest.raises(ConfigError, match="impossible") as caught:
        SamplingClient(**{"url": "http://x", **wrong})
    again = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 - our own
    assert (str(again), again.details) == (str(caught.value), caught.value.details)
