"""The client by itself, with its own queries and errors; what servers do to it, the adapters' tests say."""

import json
import pickle
import subprocess
import sys
from dataclasses import replace

import httpx
import numpy as np
import pytest

import cspace_client
from cspace_client import ClientError, PlanQuery, SamplerError, SamplingClient
from tests.fakes.sample_server import read_form

PNG = b"\x89PNG picture"


class Recorder:
    """A client whose server has no answer, and the forms that it was sent."""

    def __init__(self):
        self.forms = []
        self.client = SamplingClient("http://test:1", transport=httpx.MockTransport(self.handle))

    def handle(self, request):
        self.forms.append(read_form(request.headers["content-type"], request.read()))
        return httpx.Response(422)

    def of(self, call):
        with pytest.raises(SamplerError, match="422"):
            call(self.client)
        return self.forms.pop()


def test_numbers_of_numpy_are_sent_as_plain_ones():
    sent = Recorder()
    plain = sent.of(
        lambda client: client.sample(
            PNG, 2, 7, epsilon_sigma=(0.0, 0.5), start=(0.5, 1.0), goal=(1.0, 2.0), min_confidence=0.25
        )
    )
    numpy = sent.of(
        lambda client: client.sample(
            PNG,
            np.int64(2),
            np.uint64(7),
            epsilon_sigma=np.array([0.0, 0.5]),
            start=np.array([0.5, 1.0], np.float32),
            goal=[1, 2],
            min_confidence=np.float64(0.25),
        )
    )
    assert numpy == plain
    assert plain["min_confidence"] == [b"0.25"]
    query = PlanQuery(np.array([0.5, 1.0]), (1, 2), min_confidence=np.float64(0.5))
    form = sent.of(lambda client: client.plan(PNG, query))
    assert (form["start"], form["goal"], form["min_confidence"]) == (
        [b"[0.5, 1.0]"],
        [b"[1.0, 2.0]"],
        [b"0.5"],
    )


def test_what_a_plan_does_not_ask_for_is_left_to_the_server():
    sent = Recorder()
    assert set(sent.of(lambda client: client.plan(PNG, PlanQuery((0.0,), (1.0,))))) == {
        "image",
        "start",
        "goal",
        "seed",
    }
    views = ({"fx": 1.0}, {"fx": 2.0})
    query = PlanQuery((0.0,), (1.0,), time_limit_s=2, ways=3, next_view=True, views=views, alternatives=True)
    form = sent.of(lambda client: client.plan(PNG, query))
    assert (form["time_limit_s"], form["ways"], form["alternatives"]) == ([b"2"], [b"3"], [b"true"])
    assert "site" not in form
    assert "keep" not in form
    assert sent.of(lambda client: client.plan(PNG, replace(query, keep=True)))["keep"] == [b"true"]
    assert sent.of(lambda client: client.plan(PNG, replace(query, site="lab-3")))["site"] == [b"lab-3"]
    assert [json.loads(one) for one in form["view"]] == list(views)


def test_constraints_of_a_plan_are_sent_as_json_and_a_wrong_one_is_named():
    sent, upright = Recorder(), {"axis": (0, 0, 1), "max_rad": np.float64(0.1)}
    query = PlanQuery((0.0,), goal_pose={"pose": np.eye(4)}, limits=[(-1, 2.5), None], upright=upright)
    form = sent.of(lambda client: client.plan(PNG, replace(query, unwrapped=True)))
    told = {name: json.loads(form[name][0]) for name in ("goal_pose", "limits", "upright", "unwrapped")}
    assert told == {
        "goal_pose": {"pose": np.eye(4).tolist()},
        "limits": [[-1, 2.5], None],
        "upright": {"axis": [0, 0, 1], "max_rad": 0.1},
        "unwrapped": True,
    }
    assert "goal" not in form
    for wrong in ({"limits": [(0.0, np.nan)]}, {"upright": {"axis": object()}}):
        with pytest.raises(SamplerError, match=next(iter(wrong))):
            sent.client.plan(PNG, replace(query, **wrong))
    assert sent.forms == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"n": 2.5}, {"n": -1}, {"n": "3"}, {"n": True}, {"n": None}, {"seed": -1}, {"seed": 0.5},
        {"start": "here"}, {"start": [[0.0]]}, {"goal": [0.0, float("nan")]}, {"epsilon_sigma": ["a"]},
        {"min_confidence": "much"}, {"min_confidence": float("inf")},
    ],
    ids=str,
)  # fmt: skip
def test_a_value_that_can_not_be_sent_is_named_before_anything_is_sent(wrong):
    sent = Recorder()
    with pytest.raises(SamplerError, match=next(iter(wrong))):
        sent.client.sample(PNG, **{"n": 2, **wrong})
    assert sent.forms == []


def test_an_error_is_one_of_its_tree_and_survives_the_way_between_processes():
    with pytest.raises(ClientError) as caught:
        SamplingClient("ftp://here")
    again = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 - our own
    assert isinstance(again, cspace_client.ConfigError)
    assert isinstance(again, ValueError)
    assert (str(again), again.details) == (str(caught.value), caught.value.details)


def test_it_brings_nothing_of_the_project_and_no_framework():
    others = {"cspace", "services", "training", "inference_api", "PIL", "pydantic", "onnxruntime", "ompl"}
    code = f"import sys, cspace_client, cspace_client.local; print(sorted({others!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
