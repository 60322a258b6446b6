"""Both Python clients against the app: ``/validity`` and ``/plan``."""

import copy
import json
from dataclasses import asdict, replace
from typing import Any

import anyio
import httpx
import numpy as np
import pytest

from cspace.errors import SamplerAnswerError, SamplerError, SamplerUnavailableError
from cspace.png import encode_png
from cspace.query import PlanQuery
from cspace.simulator import Split
from cspace.worlds import examples, robot_digest, simulator_of
from services.planner.client import SamplingClient
from tests.bundles import picture
from tests.fakes.async_client import AsyncSamplingClient
from tests.inference_api.client_transports import IntoApp
from tests.services.planner.clients import KINDS

CAREFUL = "cspace-sampler@careful"
WORLD = examples()["two-link"]
PROBLEM = simulator_of(WORLD).problem("uniform", Split.VALIDATION, 0, 0)
PNG = encode_png(simulator_of(WORLD).render(PROBLEM.scenario))
ROWS = np.array([[0.1, 0.2], [3.0, -3.0], [-1.5, 1.0]])
START, GOAL = (tuple(float(angle) for angle in end) for end in (PROBLEM.start, PROBLEM.goal))
QUERY = PlanQuery(START, GOAL, seed=3, time_limit_s=10.0)


def ask(kind: str, transport: Any, question: str, *values: Any, **options: Any) -> Any:
    """One question by either client: ``validity`` or ``plan``."""
    if kind == "sync":
        with SamplingClient("http://localhost", 60.0, transport=transport, **options) as client:
            return getattr(client, question)(*values)

    async def awaited() -> Any:
        async with AsyncSamplingClient("http://localhost", 60.0, transport=transport, **options) as client:
            return await getattr(client, question)(*values)

    return anyio.run(awaited)


@pytest.mark.parametrize("kind", KINDS)
def test_beliefs_are_those_of_the_model(api, kind):
    found = ask(kind, IntoApp(api), "validity", picture(), ROWS, CAREFUL)
    form = {"model": CAREFUL, "configurations": json.dumps(ROWS.tolist())}
    answer = api.post("/validity", files={"image": encode_png(picture())}, data=form).json()
    assert np.allclose(found.confidence, answer["confidence"], atol=1e-6)
    assert found.unseen is None
    assert found.threshold == answer["threshold"] == 0.45
    assert (found.model.model_name, found.model.robot) == ("cspace-sampler", robot_digest(WORLD))
    assert found.model.novelty == pytest.approx(answer["scenario"]["novelty"], abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_a_way_and_its_alternatives_come_as_the_api_tells_them(api, kind):
    query = replace(QUERY, alternatives=True, next_view=True)
    found = ask(kind, IntoApp(api), "plan", PNG, query, CAREFUL)
    plan = found.plan
    assert (plan.status, found.reason, found.seed) == ("solved", None, 3)
    assert np.allclose(plan.path[[0, -1]], [START, GOAL], atol=1e-6)
    assert len(plan.edges) == len(plan.path) - 1
    assert plan.least.confidence == pytest.approx(float(plan.edges.min()), abs=1e-6)
    expected = {name: value for name, value in asdict(WORLD.space).items() if name != "names"}
    assert asdict(found.model.space) == expected
    assert len(plan.alternatives) == plan.found == 4
    np.testing.assert_array_equal(plan.alternatives[0].path, plan.path)
    assert plan.next_view is None


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_sure_enough_comes_with_the_reason_and_a_refusal_in_the_apis_words(api, kind):
    query = PlanQuery(START, GOAL, seed=3, min_confidence=1.0, time_limit_s=10.0)
    found = ask(kind, IntoApp(api), "plan", PNG, query, CAREFUL)
    assert (found.plan.status, len(found.plan.path)) == ("refused", 0)
    assert f"{found.plan.confidence:.3f}" in found.reason
    with pytest.raises(SamplerError, match="validity head"):
        ask(kind, IntoApp(api), "plan", PNG, QUERY, "cspace-sampler")
    with pytest.raises(SamplerError, match="start"):
        ask(kind, IntoApp(api), "plan", PNG, PlanQuery((0.0,), GOAL), CAREFUL)


@pytest.mark.parametrize("rows", [[], [0.1, 0.2], [[np.nan, 0.0]], np.zeros((20_001, 2)), np.zeros((2, 0))])
def test_configurations_that_can_not_be_are_told_before_they_are_sent(rows):
    def nobody(request: httpx.Request) -> httpx.Response:
        raise AssertionError(request)

    with pytest.raises(SamplerError, match="configurations"):
        ask("sync", httpx.MockTransport(nobody), "validity", PNG, rows)


@pytest.fixture(scope="module")
def answer(api) -> dict[str, Any]:
    """A plan as the API answers it, with its alternatives."""
    fields = {"start": json.dumps(START), "goal": json.dumps(GOAL), "seed": "3", "model": CAREFUL}
    found = api.post(
        "/plan", files={"image": PNG}, data=fields | {"time_limit_s": "10", "alternatives": "true"}
    )
    assert found.json()["status"] == "solved"
    return found.json()


def changed(answer: dict[str, Any], **changes: Any) -> httpx.MockTransport:
    """A server that gives this answer with something in it changed."""
    answer = copy.deepcopy(answer)
    for name, value in changes.items():
        part = answer["model"] if name in answer["model"] else answer
        part[name] = value(answer) if callable(value) else value
    return httpx.MockTransport(lambda request: httpx.Response(200, json=answer))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"status": "found"}, "status"),
        ({"path": lambda answer: answer["path"][:-1]}, "no complete path"),
        ({"path": lambda answer: [*answer["path"][:-1], [0.0, 0.0]]}, "leads elsewhere"),
        ({"path": lambda answer: [[9.0, 0.0], *answer["path"][1:]]}, "limits"),
        ({"path": lambda answer: [[*row, 0.0] for row in answer["path"]]}, "no complete path"),
        ({"path": []}, "no complete path"),
        ({"confidence": 1.5}, "confidence"),
        ({"edges": ["1"]}, "edges"),
        ({"edges": [True]}, "edges"),
        ({"edges": None}, "edges"),
        ({"path": [[float(10**300)], 10**400]}, "plan"),
        ({"least_sure": {}}, "least_sure"),
        ({"next_view": {"camera": 1, "sees": 0.5}}, "next_view"),
        ({"alternatives": [{"path": [], "confidence": 1.0, "edges": []}]}, "no complete path"),
        ({"alias_confirmed": "yes"}, "alias_confirmed"),
        ({"unseen": [0.5] * 99}, "no complete path"),
        ({"seed": 4}, "another seed"),
        ({"seed": "4"}, "another seed"),
        ({"seed": "-3"}, "seed"),
        ({"seed": "3 "}, "seed"),
        ({"name": "other"}, "another model"),
        ({"digest": "none"}, "digest"),
        ({"joint_space": {"kind": "torus", "dim": 99, "unit": "rad"}}, "joint space"),
        ({"status": "refused"}, "a path although none was found"),
    ],
)
def test_an_answer_that_can_not_be_is_no_plan(answer, changes, words):
    query = replace(QUERY, alternatives=True)
    with pytest.raises(SamplerAnswerError, match=words):
        ask("sync", changed(answer, **changes), "plan", PNG, query, CAREFUL)


def test_a_plan_s_seed_is_read_in_decimal_and_as_a_number_and_its_robot_has_to_be_the_clients(answer):
    for seed in (3, "3"):
        assert ask("sync", changed(answer, seed=seed), "plan", PNG, QUERY, CAREFUL).seed == 3
    for kind in KINDS:
        other = changed(answer, robot="cd" * 32)
        with pytest.raises(SamplerAnswerError, match="another robot"):
            ask(kind, other, "plan", PNG, QUERY, CAREFUL, robot=robot_digest(WORLD))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"[]",
        b"[" * 5000,
        b'{"status": NaN}',
        b"\xff",
        b'{"seed": %s}' % (b"9" * 5000),
        b'{"seed": 1e999}',
        b'{"seed": 3, "seed": 3}',
        b'{"seed": 3}',
    ],
)
def test_a_body_that_is_no_plan_is_an_error_of_the_tree(content):
    def handle(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, headers={"Content-Type": "application/json"}, content=content)

    with pytest.raises(SamplerAnswerError, match="no plan"):
        ask("sync", httpx.MockTransport(handle), "plan", PNG, QUERY)


HEADERS = {
    "Content-Type": "application/x-npy",
    "X-Model-Name": "cspace-sampler",
    "X-Model-Version": "3",
    "X-Model-Digest": "ab" * 32,
}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (np.full((2, 2), 0.5, dtype="<f4"), "another array"),
        (np.full((3, 1), 0.5, dtype="<f4"), "another array"),
        (np.full((3, 2), 0.5, dtype="<f8"), "no .npy file|too long"),
        (np.full((3, 2), 1.5, dtype="<f4"), "no shares"),
        (np.array([[0.5, np.nan], [0.5, 0.1], [0.5, 0.1]], dtype="<f4"), "no shares"),
        (np.array([[np.nan, 0.1]] * 3, dtype="<f4"), "no shares"),
    ],
)
def test_beliefs_that_can_not_be_are_no_answer(columns, words, tmp_path):
    np.save(tmp_path / "columns.npy", columns)
    content = (tmp_path / "columns.npy").read_bytes()

    def handle(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, headers=HEADERS, content=content)

    with pytest.raises(SamplerAnswerError, match=words):
        ask("sync", httpx.MockTransport(handle), "validity", PNG, ROWS)


def test_a_server_that_does_not_plan_is_away_for_plans():
    def handle(request: httpx.Request) -> httpx.Response:
        problem = {"title": "This server does not plan", "type": "urn:cspace-sampler:problem:no-planner"}
        return httpx.Response(501, json=problem)

    with pytest.raises(SamplerUnavailableError, match="does not plan"):
        ask("sync", httpx.MockTransport(handle), "plan", PNG, QUERY)
