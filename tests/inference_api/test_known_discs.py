"""Known discs in requests to planar models: what answers make of them."""

import base64
import json

import numpy as np
import pytest

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, KnownDiscs, Scenario
from tests.inference_api.answers import assert_problem

WORLD = examples()["two-link"]
PROBLEM = simulator_of(WORLD).problem("uniform", Split.VALIDATION, 0, 0)
PICTURE = simulator_of(WORLD).render(PROBLEM.scenario)
PNG = encode_png(PICTURE)
POLE = {"name": "pole", "disc": {"x_m": 1.5, "y_m": 1.0, "radius_m": 0.5}}
CAREFUL = "cspace-sampler@careful"
MODELS = [
    {"model": "cspace-sampler@champion"},
    {"model": "cspace-sampler@scored", "min_confidence": 0.0},
    {"model": CAREFUL},
    {"model": CAREFUL, "min_confidence": 1e-60},
    {"model": CAREFUL, "epsilon_sigma": [0.0, 0.5, 1.0]},
]


def checker_of(body):
    """The exact checks of an arm that stands beside this disc alone."""
    return CollisionChecker(Scenario(WORLD.body, (Disc(**body["disc"]),)))


def ask(api, page, png=PNG, **fields):
    return api.post(page, json={"image": base64.b64encode(png).decode(), "seed": 7} | fields)


def validity(api, rows, **fields):
    image = base64.b64encode(PNG).decode()
    return api.post(
        "/validity", json={"image": image, "model": CAREFUL, "configurations": rows.tolist()} | fields
    )


@pytest.mark.parametrize("fields", MODELS)
def test_no_sample_touches_a_known_disc(api, fields):
    plain = ask(api, "/sample", n=300, **fields).json()
    assert not checker_of(POLE).valid_batch(plain["samples"]).all()
    answer = ask(api, "/sample", n=300, scene=[POLE], **fields).json()
    assert len(answer["samples"]) == 300 - answer["shortfall"]
    # Few of what the tiny model proposes reach its threshold.
    assert answer["shortfall"] < (1 if fields.get("min_confidence") == 0.0 else 150)
    assert checker_of(POLE).valid_batch(answer["samples"]).all()
    # The first link cannot leave it.
    around = {"name": "base", "disc": {"x_m": 0.0, "y_m": 0.0, "radius_m": 0.1}}
    answer = ask(api, "/sample", n=30, scene=[POLE, around], **fields).json()
    assert (answer["samples"], answer["shortfall"]) == ([], 30)


def test_the_model_sees_known_discs(api):
    # In the picture and out of reach: what changes is what the model sees.
    far = {"name": "far", "disc": {"x_m": 4.6, "y_m": 4.6, "radius_m": 0.3}}
    plain, known = (ask(api, "/sample", n=50, **more).json() for more in ({}, {"scene": [far]}))
    text = json.dumps({"scene": [far]}).encode()
    drawn = KnownDiscs.read(text, WORLD.body, PICTURE).drawn(WORLD.sensor)
    assert known["samples"] == ask(api, "/sample", encode_png(drawn), n=50).json()["samples"]
    assert known["samples"] != plain["samples"]
    assert ask(api, "/sample", n=50, scene=[]).json()["samples"] == plain["samples"]


def test_what_touches_a_known_disc_has_no_confidence_and_is_told_why(api):
    rows = WORLD.space.sample_uniform(np.random.default_rng(1), 60)
    answer = validity(api, rows, scene=[POLE], explain=True).json()
    touching = ~checker_of(POLE).valid_batch(rows.astype(np.float32))
    confidence = np.array(answer["confidence"])
    assert 3 < touching.sum() < 57
    np.testing.assert_array_equal(confidence == 0.0, touching)
    for touches, why in zip(touching, answer["why"], strict=True):
        assert (why is not None) == touches
        if touches:
            assert (why["kind"], why["other"]) == ("known", "pole")
            assert f"{why['link']} touches pole" in why["text"]
    plain = validity(api, rows, explain=True).json()
    assert plain["why"] == [None] * 60


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"scene": [{"name": "a", "disc": POLE["disc"] | {"radius_m": 0.0}}]}, "scene.0.disc.radius_m"),
        ({"scene": [{"name": "a", "disc": POLE["disc"] | {"x_m": 1e7}}]}, "scene.0.disc.x_m"),
        ({"scene": [POLE, {"name": "a", "disc": {"x_m": 1.0, "y_m": 1.0}}]}, "scene.1.disc.radius_m"),
        ({"scene": [{"name": "a", "sphere": {"radius_m": 1.0}}]}, "scene.0.sphere is unknown"),
        ({"scene": [{"disc": POLE["disc"]}]}, "scene.0.name"),
        ({"scene": [POLE, POLE]}, "two discs of scene have one name"),
        ({"scene": [POLE | {"name": str(at)} for at in range(65)]}, "scene"),
        ({"allowed": [["pole", "link 1"]]}, "allowed is unknown"),
        ({"meshes": {"a": ""}}, "meshes is unknown"),
        ({"scene": [POLE], "max_age_s": 1.0}, "no stamp"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_field(api, fields, words):
    assert words in json.dumps(assert_problem(ask(api, "/sample", n=3, **fields), 422, "invalid-value"))


def test_known_discs_beside_cameras_or_several_pictures_are_refused(api):
    answer = ask(api, "/sample", scene=[POLE], state=[0.0, 0.0])
    assert "comes with a camera" in assert_problem(answer, 422, "invalid-image")["detail"]
    answer = ask(api, "/sample", scene=[POLE], image=[base64.b64encode(PNG).decode()] * 2)
    assert "2 pictures" in assert_problem(answer, 422, "invalid-image")["detail"]


def plan(api, **fields):
    ends = {"start": list(PROBLEM.start), "goal": list(PROBLEM.goal), "time_limit_s": 10.0}
    answer = ask(api, "/plan", model=CAREFUL, **ends, **fields)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_plan_keeps_clear_of_a_known_disc_that_stands_in_its_way(api):
    plain = plan(api)
    path = np.array(plain["path"])
    steps = WORLD.space.difference(path[:-1], path[1:])
    at = int(np.argmax(np.linalg.norm(steps, axis=1)))
    x_m, y_m = WORLD.body.joint_positions_m([path[at] + steps[at] / 2])[0, -1]
    body = {"name": "pole", "disc": {"x_m": x_m, "y_m": y_m, "radius_m": 0.2}}
    checker = checker_of(body)
    assert checker.valid_batch([PROBLEM.start, PROBLEM.goal]).all()
    assert not checker.edge(path[at], path[at + 1], 0.01)
    answer = plan(api, scene=[body], alternatives=True)
    assert answer["status"] == "solved"
    for one in answer["alternatives"]:
        found = np.array(one["path"])
        assert checker.edge_batch(found[:-1], found[1:], 0.005).all()
    assert plan(api, scene=[])["path"] == plain["path"]


def test_a_plan_whose_start_touches_a_known_disc_says_so(api):
    tip = WORLD.body.joint_positions_m([PROBLEM.start])[0, -1]
    body = {"name": "pole", "disc": {"x_m": tip[0], "y_m": tip[1], "radius_m": 0.05}}
    answer = plan(api, scene=[body])
    assert (answer["status"], answer["path"]) == ("refused", [])
    assert (answer["contact"]["kind"], answer["contact"]["link"]) == ("known", "link 2")
    assert "link 2 touches pole" in answer["reason"]


def test_a_refusal_names_where_the_shallowest_crossing_touches(api):
    white = encode_png(np.full_like(PICTURE, 255))
    fields = {"start": [-1.0, 0.0], "goal": [1.0, 0.0], "limits": [[-1.5, 1.5], None], "model": CAREFUL}
    pole = {"name": "pole", "disc": {"x_m": 0.5, "y_m": 0.0, "radius_m": 0.1}}
    answer = ask(api, "/plan", white, scene=[pole], explain=True, time_limit_s=10.0, **fields).json()
    assert (answer["status"], answer["contact"]["other"]) == ("refused", "pole")
    parts = "start and goal seem to lie in separate parts of what the picture shows as free"
    assert answer["reason"].startswith(f"{parts}; the shallowest crossing: link 1 touches pole by")
    assert ask(api, "/plan", white, scene=[pole], time_limit_s=10.0, **fields).json()["reason"] == parts
