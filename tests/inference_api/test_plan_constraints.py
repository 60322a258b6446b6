"""Constraints of ``POST /plan`` against the shipped models."""

import json
from typing import Any

import httpx
import numpy as np
import pytest

from cspace.files import encode_png
from cspace.planning.paths import spaced
from cspace.worlds import examples
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.test_bad_pictures import GOAL, RIGHT, START, ask, wall

WORLD = examples()["panda"]
ARM = WORLD.body
POSE = ARM.tool_frames([GOAL])[0]
DOWN = {"axis": [0, 0, 1], "up": [0, 0, -1], "max_rad": 0.3}
EMPTY = encode_png(np.full((64, 64, 3), 255, np.uint8))
PLAN = {"time_limit_s": 10.0, "min_confidence": 0.0, "seed": 1}


@pytest.fixture(scope="module")
def api(panda_api: ApiClient) -> ApiClient:
    return panda_api


def texts(**fields: Any) -> dict[str, str]:
    return {name: json.dumps(value) for name, value in fields.items() if value is not None}


def plan(api: ApiClient, goal: object = GOAL, **fields: Any) -> httpx.Response:
    return ask(api, "/plan", [wall()], [RIGHT], **texts(start=START, goal=goal, **fields))


def planar(api: ApiClient, **fields: Any) -> httpx.Response:
    return api.post("/plan", files={"image": EMPTY}, data=texts(**PLAN, **fields))


def test_an_arm_a_little_beyond_a_limit_is_led_back(api: ApiClient) -> None:
    limit = WORLD.space.upper[0]
    start, goal = [limit + 0.002, *START[1:]], [limit - 0.2, *START[1:]]
    body = texts(**PLAN, start=start, goal=goal, state=start)
    answer = ask(api, "/plan", [wall()], [RIGHT], **body).json()
    assert answer["status"] == "solved", answer
    np.testing.assert_allclose(answer["path"][:2], [start, [limit, *START[1:]]], atol=1e-6)
    assert len(answer["edges"]) == len(answer["unseen"]) == len(answer["path"]) - 1
    (told,) = [one["message"] for one in answer["warnings"] if one["code"] == "start-beyond-limit"]
    assert f"{WORLD.space.names[0]} starts 0.0020 rad beyond its limit" in told
    far = ask(api, "/plan", [wall()], [RIGHT], **texts(start=[limit + 0.2, *START[1:]], goal=goal))
    assert far.status_code == 422
    assert f"send {WORLD.space.names[0]} within its limits" in far.json()["detail"]


def test_a_plan_to_where_the_arm_stands_is_one_point(api: ApiClient) -> None:
    answer = plan(api, START, min_confidence=0.0, alternatives=True).json()
    assert answer["status"] == "solved", answer
    np.testing.assert_allclose(answer["path"], [START], atol=1e-6)
    assert (answer["edges"], answer["unseen"], answer["length_rad"]) == ([], [], 0.0)
    assert len(answer["alternatives"]) == 1


def test_a_path_to_a_tool_pose_keeps_limits_and_the_tool_upright(api: ApiClient) -> None:
    fields = {"limits": [[-0.3, 1.2], *[None] * 6], "upright": DOWN, "unwrapped": True, "state": START}
    found = plan(api, None, goal_pose={"pose": POSE.tolist()}, **fields, **PLAN).json()
    assert found["status"] == "solved", found["reason"]
    path = np.array(found["path"])
    assert np.allclose(path[0], START, atol=1e-6)
    (end,) = ARM.tool_frames(path[-1:])
    assert np.linalg.norm(end[:3, 3] - POSE[:3, 3]) <= 0.005
    assert np.trace(end[:3, :3].T @ POSE[:3, :3]) >= 1.0 + 2.0 * np.cos(0.05)
    states = spaced(path, WORLD.space, 0.003)
    assert states[:, 0].min() >= -0.3
    assert states[:, 0].max() <= 1.2
    assert (-ARM.tool_frames(states)[:, 2, 2]).min() >= np.cos(0.3)


def test_what_cannot_be_is_refused_with_the_reason(api: ApiClient) -> None:
    far = {"translation": [3.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
    refused = plan(api, None, goal_pose={"pose": far}).json()
    assert (refused["status"], refused["path"], refused["ways"]) == ("refused", [], 0)
    assert refused["reason"].startswith("the tool cannot reach goal_pose")
    tilted = plan(api, [*GOAL[:5], GOAL[5] - 0.5, GOAL[6]], upright=DOWN).json()
    assert "the goal breaks upright: the axis is 0.500 rad from up" in tilted["reason"]
    for fields, words in (
        ({"goal": None}, "got neither"),
        ({"goal_pose": {"pose": far}}, "got both"),
        ({"goal": None, "goal_pose": {"pose": far, "speed": 1}}, "goal_pose.speed"),
        ({"limits": [[-4, 4], *[None] * 6]}, "limits do not fit panda_joint1"),
        ({"limits": [[-0.3, 0.3], *[None] * 6]}, "goal lies outside the limits of this request"),
        ({"limits": [[0, 1, 2]]}, "limits.0"),
        ({"upright": {"axis": [0, 0, 0], "max_rad": 0.1}}, "upright.axis is no direction"),
        ({"upright": [0, 0, 1]}, "upright"),
        ({"unwrapped": 2}, "unwrapped"),
    ):
        assert words in assert_problem(plan(api, **fields), 422, "invalid-value")["detail"], fields


def test_circles_of_a_planar_arm_are_narrowed_and_unwrapped_and_its_tool_is_refused(api: ApiClient) -> None:
    sent = [1.5 - 2.0 * np.pi, 0.5]
    limits = [[-1.6, 1.6], None]
    kept = planar(api, start=[1.5, 3.0], goal=[-1.5, -3.0], limits=limits, unwrapped=True).json()
    turned = planar(api, start=sent, goal=[-1.5, 0.5], unwrapped=True).json()
    assert kept["status"] == turned["status"] == "solved"
    assert np.abs(np.array(kept["path"])[:, 0]).max() <= 1.6
    assert kept["path"][-1] == pytest.approx([-1.5, 2.0 * np.pi - 3.0], abs=1e-6)
    assert np.abs(np.diff(turned["path"], axis=0)).max() < np.pi
    assert turned["path"][0] == pytest.approx(sent, abs=1e-6)
    problem = assert_problem(planar(api, start=sent, goal=[0.0, 0.0], upright=DOWN), 422, "invalid-value")
    assert "no tool frame" in problem["detail"]
