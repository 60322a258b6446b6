"""``POST /validity``: what a model holds of configurations that something else drew."""

import io
import json
from typing import Any

import httpx
import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.worlds import examples, robot_digest
from tests.bundles import picture
from tests.inference_api.answers import IMAGE, PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient

CAREFUL = "cspace-sampler@careful"
NPY = {"accept": "application/x-npy"}
TWO, THREE, *_ = (robot_digest(world) for world in examples().values())
ROWS = np.random.default_rng(0).uniform(-3.0, 3.0, (40, 2))


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def ask(
    api: ApiClient, configurations: Any, headers: dict[str, str] | None = None, **fields: str
) -> httpx.Response:
    """By a form, the configurations as a file where they are bytes."""
    files: dict[str, Any] = {"image": PNG}
    data = {"model": CAREFUL, **fields}
    if isinstance(configurations, bytes):
        files["configurations"] = configurations
    else:
        data["configurations"] = json.dumps(configurations)
    return api.post("/validity", files=files, data=data, headers=headers)


@pytest.fixture(scope="module")
def expected(bundles):
    return Bundle.load(bundles["careful"]).predict(picture(), ROWS.astype(np.float32))[0]


def test_every_form_of_the_question_has_the_bundle_s_own_answer(api, expected):
    single = ROWS.astype(np.float32)
    body = {"image": IMAGE, "model": CAREFUL}
    answers = [
        ask(api, single.tolist()),
        ask(api, npy(single)),
        ask(api, npy(single.astype(np.float64))),
        ask(api, npy(np.asfortranarray(single))),
        api.post("/validity", json=body | {"configurations": single.tolist()}),
    ]
    for answer in answers:
        assert answer.status_code == 200, answer.text
        assert answer.json()["confidence"] == expected.tolist()
    body = answers[0].json()
    assert body["unseen"] is None
    assert body["threshold"] == 0.45
    assert 0.0 <= body["scenario"]["novelty"] <= 1.0
    assert body["joint_space"] == {"kind": "torus", "dim": 2, "unit": "rad"}
    assert (body["model"]["version"], body["model"]["robot"]) == (5, TWO)
    assert set(body["timing_ms"]) == {"decode", "encode", "score", "total"}


def test_an_array_holds_two_columns_and_the_rest_is_in_headers(api, expected):
    answer = ask(api, npy(ROWS.astype(np.float32)), NPY)
    assert answer.headers["content-type"] == "application/x-npy"
    found = np.load(io.BytesIO(answer.content))
    assert found.dtype == np.float32
    assert np.array_equal(found[:, 0], expected)
    assert np.isnan(found[:, 1]).all()
    assert answer.headers["x-threshold"] == "0.45"
    assert answer.headers["x-model-version"] == "5"
    assert answer.headers["x-robot"] == TWO
    assert "score;dur=" in answer.headers["server-timing"]
    assert not {"x-seed", "x-shortfall", "x-acceptance"} & set(answer.headers)


def test_a_circle_is_the_same_at_every_turn(api):
    once = ask(api, [[0.5, -1.0]]).json()["confidence"]
    assert ask(api, [[0.5 + 4 * np.pi, -1.0 - 2 * np.pi]]).json()["confidence"] == pytest.approx(once)


def test_samples_are_scored_as_they_were_when_they_were_drawn(api):
    drawn = api.post("/sample", files={"image": PNG}, data={"n": "20", "seed": "1", "model": CAREFUL}).json()
    assert ask(api, drawn["samples"]).json()["confidence"] == pytest.approx(drawn["confidence"], abs=1e-6)


WRONG = {
    "none": [],
    "an empty row": [[]],
    "one row alone": [1.0, 2.0],
    "texts": [["1.0", "2.0"]],
    "another robot's": [[0.0, 0.0, 0.0]],
    "an array of too many": npy(np.zeros((20_001, 2), np.float32)),
    "an array of another robot's": npy(np.zeros((3, 3))),
    "a vector": npy(np.zeros(4)),
    "not finite": npy(np.full((2, 2), np.nan)),
    "Python objects": npy(np.array([[print, print]], dtype=object)),
    "with more behind it": npy(np.zeros((2, 2))) + b"0",
    "nothing": b"",
    "a picture": PNG,
}


@pytest.mark.parametrize("name", WRONG)
def test_what_are_no_configurations_is_refused(api, name):
    problem = assert_problem(ask(api, WRONG[name]), 422, "invalid-value")
    assert "configurations" in problem["detail"] or problem["errors"][0]["field"].startswith("configurations")


def test_what_else_is_wrong_is_refused_as_of_samples(api):
    (error,) = assert_problem(ask(api, ROWS.tolist(), n="3"), 422, "invalid-value")["errors"]
    assert error["field"] == "n"
    problem = assert_problem(api.post("/validity", json={}), 422, "invalid-value")
    assert {error["field"] for error in problem["errors"]} == {"image", "configurations"}
    problem = assert_problem(ask(api, ROWS.tolist(), model="pretrained"), 422, "invalid-value")
    assert "validity head" in problem["detail"]
    assert ask(api, ROWS.tolist(), robot=TWO).status_code == 200
    assert_problem(ask(api, ROWS.tolist(), robot=THREE), 409, "other-robot")
    answer = api.post("/validity", files={"image": b"GIF", "configurations": npy(ROWS)})
    assert_problem(answer, 422, "invalid-image")
    assert_answers(api)
