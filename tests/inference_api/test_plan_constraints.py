"""Constraints of ``POST /plan`` against the shipped models, by the client and by plain HTTP."""

import json

import numpy as np
import pytest

from cspace.planning.paths import spaced
from cspace.png import encode_png
from cspace.worlds import examples
from cspace_client import DepthPictures, PlanQuery, SamplerAnswerError, SamplerError, SamplingClient
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.client_transports import IntoApp
from tests.inference_api.test_bad_pictures import GOAL, PANDA, RIGHT, START, ask, wall
from tests.inference_api.test_python_clients import changed

WORLD = examples()["panda"]
ARM = WORLD.body
POSE = ARM.tool_frames([GOAL])[0]
DOWN = {"axis": [0, 0, 1], "up": [0, 0, -1], "max_rad": 0.3}
EMPTY = encode_png(np.full((64, 64, 3), 255, np.uint8))
LIMITS = [(-0.3, 1.2), *[None] * 6]
PLAN = {"time_limit_s": 10.0, "min_confidence": 0.0, "seed": 1}


@pytest.fixture(scope="module")
def api(panda_api: ApiClient) -> ApiClient:
    return panda_api


def test_a_client_gets_a_path_to_a_tool_pose_that_keeps_limits_and_the_tool_upright(api: ApiClient) -> None:
    query = PlanQuery(START, goal_pose={"pose": POSE}, limits=LIMITS, upright=DOWN, unwrapped=True, **PLAN)
    with SamplingClient("http://localhost", 60.0, transport=IntoApp(api)) as client:
        found = client.plan(DepthPictures([wall()], [RIGHT], START), query, PANDA)
    assert found.plan.status == "solved", found.reason
    path = found.plan.path
    assert np.allclose(path[0], START, atol=1e-6)
    (end,) = ARM.tool_frames(path[-1:])
    assert np.linalg.norm(end[:3, 3] - POSE[:3, 3]) <= 0.005
    assert np.trace(end[:3, :3].T @ POSE[:3, :3]) >= 1.0 + 2.0 * np.cos(0.05)
    states = spaced(path, WORLD.space, 0.003)
    assert states[:, 0].min() >= -0.3
    assert states[:, 0].max() <= 1.2
    assert (-ARM.tool_frames(states)[:, 2, 2]).min() >= np.cos(0.3)


def test_what_cannot_be_is_refused_with_the_reason_and_what_is_none_by_its_name(api: ApiClient) -> None:
    def answer(goal: object = GOAL, **fields: object):
        texts = {name: json.dumps(value) for name, value in ({"start": START, "goal": goal} | fields).items()}
        return ask(
            api, "/plan", [wall()], [RIGHT], **{name: text for name, text in texts.items() if text != "null"}
        )

    far = {"translation": [3.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
    refused = answer(None, goal_pose={"pose": far}).json()
    assert (refused["status"], refused["path"], refused["ways"]) == ("refused", [], 0)
    assert refused["reason"].startswith("the tool cannot reach goal_pose")
    tilted = answer([*GOAL[:5], GOAL[5] - 0.5, GOAL[6]], upright=DOWN).json()
    assert "the goal breaks upright: the axis is 0.500 rad from up" in tilted["reason"]
    for fields, words in (
        ({"goal": None}, "got neither"),
        ({"goal_pose": {"pose": far}}, "got both"),
        ({"goal": None, "goal_pose": {"pose": far, "speed": 1}}, "goal_pose: speed is unknown"),
        ({"limits": [[-4, 4], *[None] * 6]}, "limits do not fit panda_joint1"),
        ({"limits": [[-0.3, 0.3], *[None] * 6]}, "goal lies outside the limits of this request"),
        ({"upright": {"axis": [0, 0, 0], "max_rad": 0.1}}, "upright.axis is no direction"),
    ):
        assert words in assert_problem(answer(**fields), 422, "invalid-value")["detail"]
    for field, value in (("limits", [[0, 1, 2]]), ("upright", [0, 0, 1]), ("goal_pose", 1), ("unwrapped", 2)):
        problem = assert_problem(answer(**{field: value}), 422, "invalid-value")
        assert problem["errors"][0]["field"] == field


def test_circles_of_a_planar_arm_are_narrowed_and_unwrapped_and_its_tool_is_refused(api: ApiClient) -> None:
    limits, sent = [(-1.6, 1.6), None], (1.5 - 2.0 * np.pi, 0.5)
    with SamplingClient("http://localhost", 60.0, transport=IntoApp(api)) as client:
        kept = client.plan(EMPTY, PlanQuery((1.5, 3.0), (-1.5, -3.0), limits=limits, unwrapped=True, **PLAN))
        turned = client.plan(EMPTY, PlanQuery(sent, (-1.5, 0.5), unwrapped=True, **PLAN))
        with pytest.raises(SamplerError, match="no tool frame"):
            client.plan(EMPTY, PlanQuery(sent, (0.0, 0.0), upright=DOWN))
    assert kept.plan.status == turned.plan.status == "solved"
    assert np.abs(kept.plan.path[:, 0]).max() <= 1.6
    assert kept.plan.path[-1] == pytest.approx([-1.5, 2.0 * np.pi - 3.0], abs=1e-6)
    assert np.abs(np.diff(turned.plan.path, axis=0)).max() < np.pi
    assert turned.plan.path[0] == pytest.approx(sent, abs=1e-6)


def test_a_client_refuses_a_path_that_jumps_or_leaves_its_limits(api: ApiClient) -> None:
    fields = {
        "start": "[3.0, 0.5]",
        "goal": "[-3.0, 0.5]",
        "time_limit_s": "10",
        "seed": "1",
        "min_confidence": "0",
    }
    answer = api.post("/plan", files={"image": EMPTY}, data=fields).json()
    assert answer["status"] == "solved", answer["reason"]
    wrapped = {"path": [[3.0, 0.5], [-3.0, 0.5]], "edges": [1.0]}
    for change, words in (({"unwrapped": True}, "jumps"), ({"limits": [(-3.1, 3.1), (0.0, 0.4)]}, "limits")):
        asked = PlanQuery((3.0, 0.5), (-3.0, 0.5), seed=1, **change)
        client = SamplingClient("http://localhost", transport=changed(answer, **wrapped))
        with client, pytest.raises(SamplerAnswerError, match=words):
            client.plan(EMPTY, asked)
