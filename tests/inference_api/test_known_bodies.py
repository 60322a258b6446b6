"""Known, attached and ignored bodies in requests: what answers make of them."""

import base64
import json

import numpy as np
import pytest
import trimesh

from cspace.simulator import ProblemRequest, Split
from cspace.view_file import unpack_view
from cspace.worlds import examples, partly_seen
from cspace.worlds.spatial.view import write_view
from tests.inference_api.answers import assert_problem

WORLD = examples()["panda"]
PROBLEM = partly_seen(WORLD).problem(ProblemRequest(Split.VALIDATION), "motionbench_table_pick", 1, 1)
VIEW = unpack_view(write_view(PROBLEM.scenario.view()))
MODEL = "panda-sampler@champion"
ROWS = WORLD.space.sample_uniform(np.random.default_rng(1), 60)
BODY = {
    "model": MODEL,
    "image": [base64.b64encode(one).decode() for one in VIEW.pictures],
    "camera": VIEW.cameras,
    "state": VIEW.state,
}
WALL = {"name": "wall", "box": {"size_m": [2.0, 0.1, 2.0]}, "pose": {"translation": [0.0, 0.35, 0.5]}}


@pytest.fixture(scope="module")
def api(space_api):
    return space_api


def ask(api, page, **fields):
    return api.post(page, json=BODY | fields)


def behind_the_wall(rows):
    """Whether a sphere of the arm's moving parts reaches the wall."""
    arm = WORLD.body
    moving = arm.sphere_links() > 0
    places = arm.sphere_centres_m(np.asarray(rows))[:, moving]
    gaps = np.abs(places - (0.0, 0.35, 0.5)) - (1.0, 0.05, 1.0)
    away = np.linalg.norm(np.maximum(gaps, 0.0), axis=2) + np.minimum(gaps.max(axis=2), 0.0)
    return (away <= arm.spheres_m()[moving, 3]).any(axis=1)


def test_what_touches_a_known_body_has_no_confidence_and_is_told_why(api):
    plain = ask(api, "/validity", configurations=ROWS.tolist()).json()
    known = ask(api, "/validity", configurations=ROWS.tolist(), scene=[WALL], explain=True).json()
    touching = behind_the_wall(ROWS)
    assert 3 < touching.sum() < 57
    confidence = np.array(known["confidence"])
    assert (confidence[touching] == 0.0).all()
    assert (confidence[~touching] > 0.0).any()
    for row, why in enumerate(known["why"]):
        assert (why is None) == (confidence[row] >= 0.5)
        if touching[row]:
            assert (why["kind"], why["other"]) == ("known", "wall")
            assert "touches wall" in why["text"]
    assert "why" not in plain
    assert plain == ask(api, "/validity", configurations=ROWS.tolist()).json() | {
        "timing_ms": plain["timing_ms"]
    }


def test_samples_keep_clear_of_known_bodies_whatever_confidence_is_wanted(api):
    for least in (0.0, 0.1):
        answer = ask(api, "/sample", n=40, seed=1, scene=[WALL], min_confidence=least).json()
        assert len(answer["samples"]) > 5
        assert not behind_the_wall(answer["samples"]).any()


def test_a_mesh_comes_as_a_file_of_a_form_or_in_base64(api):
    wall = trimesh.creation.box((2000.0, 100.0, 2000.0)).export(file_type="stl")
    body = {"name": "wall", "mesh": {"file": "wall.stl", "scale": 0.001}, "pose": WALL["pose"]}
    rows = ROWS.tolist()
    meshes = {"wall.stl": base64.b64encode(wall).decode()}
    plain = ask(api, "/validity", configurations=rows, scene=[body], meshes=meshes).json()
    files = [("image", one) for one in VIEW.pictures] + [("mesh", ("wall.stl", wall))]
    data = {
        "model": MODEL,
        "camera": [json.dumps(one) for one in VIEW.cameras],
        "state": json.dumps(VIEW.state),
        "scene": json.dumps([body]),
        "configurations": json.dumps(rows),
    }
    form = api.post("/validity", files=files, data=data)
    assert form.json()["confidence"] == plain["confidence"]
    box = ask(api, "/validity", configurations=rows, scene=[WALL]).json()
    np.testing.assert_allclose(plain["confidence"], box["confidence"], atol=0.02)
    missing = ask(api, "/validity", configurations=rows, scene=[body])
    assert "wall.stl" in assert_problem(missing, 422, "invalid-value")["detail"]


def test_a_plan_whose_start_touches_a_known_body_says_what_and_where(api):
    tool = WORLD.body.tool_frames(np.asarray(PROBLEM.start)[None])[0][:3, 3]
    ball = {"name": "ball", "sphere": {"radius_m": 0.05}, "pose": {"translation": tool.tolist()}}
    ends = {"start": list(PROBLEM.start), "goal": list(PROBLEM.goal), "seed": 1, "min_confidence": 0.0}
    answer = ask(api, "/plan", **ends, scene=[ball]).json()
    assert answer["status"] == "refused"
    assert (answer["contact"]["kind"], answer["contact"]["other"]) == ("known", "ball")
    assert "touches ball" in answer["reason"]
    assert np.linalg.norm(np.subtract(answer["contact"]["position_m"], tool)) < 0.2
    free = ask(api, "/plan", **ends).json()
    assert "contact" not in free
    hand = ["panda_hand", "panda_leftfinger", "panda_rightfinger", "panda_link7"]
    allowed = ask(api, "/plan", **ends, scene=[ball], allowed=[[one, "ball"] for one in hand]).json()
    assert allowed.get("contact") is None or allowed["contact"]["other"] != "ball"


def test_where_everything_is_known_plans_are_certain_and_the_shortest_path_is_the_answer(api):
    ends = {"start": list(PROBLEM.start), "goal": list(PROBLEM.goal), "seed": 1, "alternatives": True}
    plain = ask(api, "/plan", **ends, min_confidence=0.0, scene=[WALL]).json()
    assert plain["confidence"] < 1.0
    whole = {"box": {"size_m": [4.0, 4.0, 4.0]}}
    found = ask(api, "/plan", **ends, min_confidence=1.0, scene=[WALL], ignore=[whole]).json()
    assert (found["status"], found["confidence"]) == ("solved", 1.0)
    assert set(found["edges"]) == {1.0}
    assert set(found["unseen"]) == {0.0}
    assert not behind_the_wall(np.concatenate(np.linspace(found["path"][:-1], found["path"][1:], 40))).any()
    lengths = [np.linalg.norm(np.diff(one["path"], axis=0), axis=1).sum() for one in found["alternatives"]]
    assert lengths == sorted(lengths)
    assert len(lengths) == 4


def test_wrong_bodies_are_refused_with_the_field(api):
    for fields, words in (
        ({"scene": [{"name": "a", "box": {"size_m": [1, -1, 1]}}]}, "scene.0.box.size_m.1"),
        ({"attached": [{"name": "a", "sphere": {"radius_m": 0.1}, "link": "nose"}]}, "nose"),
        ({"scene": [WALL | {"name": str(at)} for at in range(501)]}, "scene"),
        ({"scene": "a table"}, "scene"),
        ({"allowed": [["a"]]}, "allowed"),
    ):
        answer = ask(api, "/validity", configurations=ROWS.tolist(), **fields)
        assert words in json.dumps(assert_problem(answer, 422, "invalid-value"))
    many = ask(api, "/validity", configurations=[VIEW.state] * 1001, explain=True)
    assert "1000" in assert_problem(many, 422, "invalid-value")["detail"]
