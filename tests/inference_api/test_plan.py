"""``POST /plan``: a path that a model predicts to be free, or the reason why there is none."""

import base64
import json
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, robot_digest, simulator_of
from tests.inference_api.answers import assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.raw import until

CAREFUL = "cspace-sampler@careful"
WORLD = examples()["two-link"]
PROBLEM = simulator_of(WORLD).problem("uniform", Split.VALIDATION, 0, 0)
PNG = encode_png(simulator_of(WORLD).render(PROBLEM.scenario))
ENDS = {"start": list(PROBLEM.start), "goal": list(PROBLEM.goal)}
QUESTION: dict[str, Any] = {**ENDS, "model": CAREFUL, "seed": 3, "time_limit_s": 10.0}


def ask(api: ApiClient, **fields: Any):
    body = {**QUESTION, "image": base64.b64encode(PNG).decode(), **fields}
    return api.post("/plan", json={name: value for name, value in body.items() if value is not None})


def test_a_way_comes_back_with_what_is_believed_of_it(api):
    answer = ask(api).json()
    assert answer["status"] == "solved"
    assert answer["reason"] is None
    assert np.allclose(answer["path"][0], PROBLEM.start, atol=1e-6)
    assert np.allclose(answer["path"][-1], PROBLEM.goal, atol=1e-6)
    assert len(answer["edges"]) == len(answer["path"]) - 1
    assert 0.0 < answer["confidence"] <= min(answer["edges"])
    assert answer["least_sure"]["confidence"] == pytest.approx(min(answer["edges"]), abs=1e-6)
    assert answer["unseen"] is None
    assert (answer["ways"], answer["seed"]) == (4, "3")
    assert answer["model"]["robot"] == robot_digest(WORLD)
    assert set(answer["timing_ms"]) == {"decode", "encode", "search", "score", "total"}
    lengths = WORLD.space.distance(answer["path"][:-1], answer["path"][1:])
    assert answer["length_rad"] == pytest.approx(lengths.sum())


def test_a_form_has_the_same_answer_and_a_seed_gives_the_same_way(api):
    data = {name: value if isinstance(value, str) else json.dumps(value) for name, value in QUESTION.items()}
    by_form = api.post("/plan", files={"image": PNG}, data=data)
    assert by_form.status_code == 200, by_form.text
    assert by_form.json()["path"] == ask(api).json()["path"]
    assert ask(api, seed="18446744073709551615").json()["seed"] == "18446744073709551615"
    drawn = ask(api, seed=None).json()["seed"]
    assert isinstance(drawn, str)
    assert ask(api, seed=drawn).json()["seed"] == drawn


def test_all_ways_that_are_sure_enough_come_where_they_are_asked_for(api):
    plain = ask(api).json()
    assert plain["alternatives"] is None
    answer = ask(api, alternatives=True).json()
    ways = answer["alternatives"]
    assert {name: ways[0][name] for name in ("path", "confidence", "edges")} == {
        name: plain[name] for name in ("path", "confidence", "edges")
    }
    sure = [path["confidence"] for path in ways]
    assert len(sure) == 4
    assert sure == sorted(sure, reverse=True)
    some = ask(api, alternatives=True, min_confidence=sure[3]).json()["alternatives"]
    assert [path["confidence"] for path in some] == [one for one in sure if one >= sure[3]]
    assert ask(api, alternatives=True, min_confidence=min(1.0, sure[0] + 1e-3)).json()["alternatives"] == []


def test_a_path_comes_in_time_where_limits_of_motion_are_known(api):
    assert "trajectory" not in ask(api).json()
    answer = ask(api, max_velocity_rad_s=[1.0, 2.0], max_acceleration_rad_s2=[3.0, 3.0]).json()
    found = answer["trajectory"]
    count = len(found["times_s"])
    assert np.shape(found["positions"]) == np.shape(found["velocities"]) == (count, 2)
    assert np.allclose(WORLD.space.difference(found["positions"][-1], answer["path"][-1]), 0.0)
    assert (np.abs(found["velocities"]).max(axis=0) <= [1.0 + 1e-9, 2.0 + 1e-9]).all()
    assert found["times_s"] == sorted(found["times_s"])
    checker = simulator_of(WORLD).checker(PROBLEM.scenario)
    spline = CubicHermiteSpline(found["times_s"], found["positions"], found["velocities"])
    assert checker.valid_batch(WORLD.space.wrap(spline(np.linspace(0.0, found["times_s"][-1], 500)))).all()
    assert ask(api, max_velocity_rad_s=[1.0, 2.0]).json()["status"] == "solved"
    for wrong in ([1.0], [1.0, 0.0]):
        problem = assert_problem(ask(api, max_velocity_rad_s=wrong), 422, "invalid-value")
        assert "max_velocity_rad_s" in json.dumps(problem)


def test_a_risk_is_what_a_confidence_leaves(api):
    sure = ask(api).json()["confidence"]
    assert ask(api, max_risk=1.0 - sure + 1e-3).json()["status"] == "solved"
    refused = ask(api, max_risk=max(0.0, 1.0 - sure - 1e-3)).json()
    assert f"{1.0 - sure:.3f}; " in refused["reason"]
    assert (refused["status"], refused["confidence"]) == ("refused", sure)
    problem = assert_problem(ask(api, max_risk=0.1, min_confidence=0.5), 422, "invalid-value")
    assert "max_risk" in problem["detail"]


def test_a_way_that_is_not_sure_enough_is_refused_with_the_reason(api):
    sure = ask(api).json()["confidence"]
    answer = ask(api, min_confidence=min(1.0, sure + 1e-3)).json()
    assert (answer["status"], answer["path"], answer["edges"]) == ("refused", [], [])
    assert answer["confidence"] == sure
    assert f"{sure:.3f}" in answer["reason"]
    assert len(answer["least_sure"]["configuration"]) == 2


def test_what_does_not_fit_is_told_by_its_field(api):
    wrong = {
        "start": [None],
        "goal": [[0.0], "home"],
        "min_confidence": [1.5],
        "time_limit_s": [0.0, 11.0],
        "ways": [0, 65, 2.5],
        "seed": [-1],
        "n": [10],
    }
    for field, values in wrong.items():
        for value in values:
            problem = assert_problem(ask(api, **{field: value}), 422, "invalid-value")
            assert field in problem["detail"] or problem["errors"][0]["field"] == field
    assert_answers(api)


def test_a_model_without_a_head_and_one_of_another_robot_do_not_plan(api):
    problem = assert_problem(ask(api, model="cspace-sampler/1"), 422, "invalid-value")
    assert "validity head" in problem["detail"]
    assert_problem(ask(api, robot=robot_digest(examples()["three-link"])), 409, "other-robot")


def test_a_server_is_not_ready_before_its_search_is_loaded(own_api):
    api = own_api
    assert api.get("/health/ready").status_code == 200
    api.app.state.kernels.state = "loading"
    problem = assert_problem(api.get("/health/ready"), 503, "starting")
    assert "ask again" in problem["remedy"]
    assert_problem(ask(api), 503, "starting")
    assert api.get("/health/live").status_code == 200
    api.app.state.kernels.begin()
    until(lambda: api.get("/health/ready").status_code == 200)
