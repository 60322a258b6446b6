"""Pictures and cameras that are worse than they seem: no answer is surer for it, each says what is wrong."""

import base64
import json
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from cspace.view_file import pack_view
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, looking
from cspace_client import DepthPictures, PlanQuery, SamplingClient
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.client_transports import IntoApp

PANDA = "pretrained-panda"
START = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
GOAL = [0.6, 0.2, 0.0, -1.9, 0.0, 2.1, 0.785]
REACH_OUT = [0.0, 0.5, 0.0, -1.9, 0.0, 2.4, 0.785]
EYE, AIM = (1.25, -0.6, 0.95), (0.3125, 0.103, 0.0126)
NONE = "the camera sees none of the space that the arm can reach"
Depth = NDArray[np.uint16]


def camera_of(pose: NDArray[np.float64], **changes: Any) -> dict[str, Any]:
    return {"fx": 46.0, "fy": 46.0, "cx": 31.5, "cy": 23.5, "pose": pose.tolist()} | changes


RIGHT = camera_of(looking(EYE, AIM))
AWAY = camera_of(looking(EYE, (2.5, -1.4, 1.3)))
# As OpenGL and Blender have it: y up, z backwards.
OPENGL = camera_of(looking(EYE, AIM) @ np.diag([1.0, -1.0, -1.0, 1.0]))


def wall(near_mm: int = 900, far_mm: int = 1500) -> Depth:
    """A wall, and a thing before it."""
    depth = np.full((48, 64), far_mm, np.uint16)
    depth[20:30, 25:40] = near_mm
    return depth


def holed(value: int) -> Depth:
    """A wall with a hole that a driver tells in its own way."""
    depth = np.full((48, 64), 1500, np.uint16)
    depth[8:40, 12:52] = value
    return depth


@pytest.fixture(scope="module")
def api(panda_api: ApiClient) -> ApiClient:
    return panda_api


def ask(
    api: ApiClient, page: str, pictures: list[Depth], cameras: list[dict[str, Any]], **fields: Any
) -> httpx.Response:
    files = [("image", encode_depth(one)) for one in pictures]
    data = {"model": PANDA, "camera": [json.dumps(one) for one in cameras], **fields}
    return api.post(page, files=files, data=data)


def score(api: ApiClient, depth: Depth, camera: dict[str, Any] = RIGHT, **fields: Any) -> dict[str, Any]:
    rows = json.dumps([START, GOAL, REACH_OUT])
    answer = ask(api, "/validity", [depth], [camera], configurations=rows, **fields)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def codes(answer: dict[str, Any]) -> list[str]:
    return [one["code"] for one in answer["warnings"]]


PAGES = {
    "/sample": {"n": "5"},
    "/validity": {"configurations": json.dumps([GOAL])},
    "/plan": {"start": json.dumps(START), "goal": json.dumps(GOAL)},
}


@pytest.mark.parametrize(
    ("page", "camera"), [("/sample", AWAY), ("/validity", OPENGL), ("/plan", AWAY)], ids=list(PAGES)
)
def test_a_camera_that_sees_none_of_the_reach_is_refused_with_the_reason(
    api: ApiClient, page: str, camera: dict[str, Any]
) -> None:
    problem = assert_problem(ask(api, page, [wall()], [camera], **PAGES[page]), 422, "invalid-image")
    assert NONE in problem["detail"]
    assert "that looks along" in problem["got"]
    assert "z forward" in problem["remedy"]


def test_metres_instead_of_millimetres_are_refused_and_the_unit_is_named(api: ApiClient) -> None:
    answer = ask(api, "/sample", [wall(0, 1)], [RIGHT], **PAGES["/sample"])
    problem = assert_problem(answer, 422, "invalid-image")
    assert "no reading" in problem["detail"]
    assert "depth_scale_m" in problem["remedy"]


def test_tensors_are_refused_likewise(api: ApiClient) -> None:
    inputs = [
        {"name": "depth", "datatype": "UINT16", "shape": [1, 48, 64], "data": wall().ravel().tolist()},
        {"name": "intrinsics", "datatype": "FP64", "shape": [1, 4], "data": [46.0, 46.0, 31.5, 23.5]},
        {"name": "poses", "datatype": "FP64", "shape": [1, 4, 4], "data": np.ravel(AWAY["pose"]).tolist()},
    ]
    answer = api.post(f"/v2/models/{PANDA}/infer", json={"inputs": inputs, "parameters": {"n": 3}})
    assert answer.status_code == 400
    assert NONE in answer.json()["error"]


def test_of_several_pictures_one_that_sees_nothing_is_told_and_changes_nothing(api: ApiClient) -> None:
    rows = json.dumps([START, GOAL, REACH_OUT])
    both = ask(api, "/validity", [wall(), wall()], [AWAY, RIGHT], configurations=rows).json()
    alone = score(api, wall())
    assert (both["confidence"], both["unseen"]) == (alone["confidence"], alone["unseen"])
    found = next(one for one in both["warnings"] if one["code"] == "nothing-in-reach")
    assert found["pictures"] == [0]
    assert "nothing-in-reach" not in codes(alone)


def test_a_picture_that_shows_next_to_nothing_is_as_novel_as_can_be_and_no_plan_is_sure(
    api: ApiClient,
) -> None:
    # Some litres before a wall.
    camera = DepthCamera.of_field(64, 48, 12.0, looking((1.06, 0.0, 0.4), (0.0, 0.0, 0.4)))
    camera_values = camera_of(
        camera.matrix, **{name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    )
    depth = np.full((48, 64), 200, np.uint16)
    found = score(api, depth, camera_values)
    assert found["scenario"]["novelty"] > 0.9
    assert "little-in-reach" in codes(found)
    plan = ask(api, "/plan", [depth], [camera_values], **PAGES["/plan"]).json()
    assert plan["status"] == "refused"
    assert "of the space that the arm can reach" in plan["reason"]
    taken = ask(api, "/plan", [depth], [camera_values], **PAGES["/plan"], min_confidence="0.1").json()
    assert taken["status"] == "solved"


@pytest.mark.parametrize("value", [65535, 10001, 19])
def test_what_no_depth_camera_reads_is_no_reading(api: ApiClient, value: int) -> None:
    hole, far = score(api, holed(0)), score(api, holed(value))
    assert (far["confidence"], far["unseen"]) == (hole["confidence"], hole["unseen"])
    np.testing.assert_allclose(far["unseen"][1:], [0.454, 0.751], atol=1e-3)
    np.testing.assert_allclose(far["confidence"][1:], [0.984, 0.957], atol=1e-3)
    assert ("out-of-range" in codes(far), "out-of-range" in codes(hole)) == (True, False)


def test_the_unit_of_depths_can_be_said_at_every_door(api: ApiClient) -> None:
    right, fifths = score(api, wall()), wall(4500, 7500)
    assert right["confidence"][1] == pytest.approx(0.16, abs=0.005)
    form = score(api, fifths, depth_scale_m="0.0002")
    body = {
        "model": PANDA,
        "image": base64.b64encode(encode_depth(fifths)).decode(),
        "camera": RIGHT,
        "configurations": [START, GOAL, REACH_OUT],
    }
    plain = api.post("/validity", json=body | {"depth_scale_m": 0.0002}).json()
    view = pack_view([encode_depth(fifths)], [RIGHT], None, 0.0002)
    packed = api.post(
        "/validity",
        files={"image": view},
        data={"model": PANDA, "configurations": json.dumps(body["configurations"])},
    ).json()
    with SamplingClient("http://localhost", transport=IntoApp(api)) as client:
        depth = DepthPictures([fifths], [RIGHT], depth_scale_m=0.0002)
        scored = client.validity(depth, body["configurations"], PANDA)
    np.testing.assert_array_equal(scored.confidence, np.float32(right["confidence"]))
    for one in (form, plain, packed):
        assert (one["confidence"], one["unseen"]) == (right["confidence"], right["unseen"])
    problem = assert_problem(api.post("/validity", json=body | {"depth_scale_m": 0.0}), 422, "invalid-value")
    assert problem["errors"][0]["field"] == "depth_scale_m"
    alone = {"model": PANDA, "image": body["image"], "depth_scale_m": 0.001}
    assert (
        "without a camera" in assert_problem(api.post("/sample", json=alone), 422, "invalid-value")["detail"]
    )


def test_another_unit_without_a_word_is_told(api: ApiClient) -> None:
    found = score(api, wall(4500, 7500))
    warning = next(one for one in found["warnings"] if one["code"] == "no-surface-in-reach")
    assert "depth_scale_m" in warning["message"]
    assert "0.0002" in warning["message"]
    assert "no-surface-in-reach" not in codes(score(api, wall()))


def test_a_camera_of_other_pictures_is_told(api: ApiClient) -> None:
    assert "focal-lengths" in codes(score(api, wall(), RIGHT | {"fx": 26.0}))
    assert "focal-lengths" not in codes(score(api, wall()))


def test_pixels_of_the_arm_are_told_where_no_state_was_sent(api: ApiClient) -> None:
    # The wall goes through the base, as the front of an arm that is seen does.
    assert "arm-in-picture" in codes(score(api, wall()))
    assert "arm-in-picture" not in codes(score(api, wall(), state=json.dumps(START)))
    assert "arm-in-picture" not in codes(score(api, wall(2500, 2500)))
    plan = ask(api, "/plan", [wall()], [RIGHT], **PAGES["/plan"]).json()
    assert plan["status"] == "refused"
    assert "`state`" in plan["reason"]
    assert any("`state`" in one["message"] for one in plan["warnings"])


def test_clients_are_told_of_all_of_it(api: ApiClient) -> None:
    with SamplingClient("http://localhost", transport=IntoApp(api)) as client:
        picture = DepthPictures([wall(4500, 7500)], [RIGHT])
        batch = client.sample(picture, 5, seed=1, model=PANDA)
        found = client.plan(picture, PlanQuery(START, GOAL), PANDA)
        beliefs = client.validity(picture, [GOAL], PANDA)
    warning = score(api, wall(4500, 7500))["warnings"]
    for warnings in (batch.warnings, found.model.warnings, beliefs.model.warnings):
        assert [(one.code, one.message) for one in warnings] == [
            (one["code"], one["message"]) for one in warning
        ]
