"""The client behind the project's port: its queries, and its errors as the project's."""

import httpx
import numpy as np
import pytest

import cspace.errors
from cspace.query import PlanQuery, SampleQuery
from services.planner.samples import SamplingClient
from tests.fakes.sample_server import read_form, sample_answer

PNG = b"\x89PNG picture"
ROWS = [[0.5, -3.0], [3.0, 1.0]]


def client_of(answer, sent=None):
    def handle(request):
        request.read()
        if sent is not None:
            sent.append(read_form(request.headers["content-type"], request.content))
        if isinstance(answer, Exception):
            raise answer
        return answer

    return SamplingClient("http://test:1", retries=0, transport=httpx.MockTransport(handle))


def test_queries_of_the_project_are_sent_as_the_contract_has_them():
    sent = []
    query = SampleQuery(2, 7, (0.0, 0.5), (0.5, 1.0), (1.0, 2.0), 0.25, "ab" * 32)
    batch = client_of(httpx.Response(200, content=sample_answer(ROWS)), sent).answer(PNG, query, "m@a")
    np.testing.assert_array_equal(batch.samples, np.float32(ROWS))
    assert sent.pop() == {
        "image": [PNG],
        "n": [b"2"],
        "seed": [b"7"],
        "epsilon_sigma": [b"0.0", b"0.5"],
        "start": [b"[0.5, 1.0]"],
        "goal": [b"[1.0, 2.0]"],
        "min_confidence": [b"0.25"],
        "model": [b"m@a"],
        "robot": [b"ab" * 32],
    }
    query = PlanQuery((0.0,), None, 3, limits=((-1.0, 1.0),), goal_pose={"pose": np.eye(4).tolist()})
    with pytest.raises(cspace.errors.SamplerError, match="422"):
        client_of(httpx.Response(422), sent).plan(PNG, query)
    form = sent.pop()
    assert (form["limits"], form["seed"]) == ([b"[[-1.0, 1.0]]"], [b"3"])
    assert "goal" not in form


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (httpx.ConnectError("refused"), cspace.errors.SamplerUnavailableError),
        (httpx.Response(200, content=b"{}"), cspace.errors.SamplerUnavailableError),
        (httpx.Response(422), cspace.errors.SamplerError),
    ],
    ids=["away", "no answer", "refused"],
)
def test_errors_are_those_of_the_project(answer, error):
    with pytest.raises(error) as caught:
        client_of(answer).sample(PNG, 2, seed=1)
    assert type(caught.value) is error
