"""Pictures and cameras that are worse than they seem: warnings, refusals, diagnoses and expected space."""

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from cspace.files import encode_png
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, looking
from cspace.worlds.spatial.poses import make_pose, pose_of, turn
from tests.bundles import picture
from tests.cspace.worlds.spatial.test_diagnosis import CAMERA, PICTURE, STATE, order_wxyz
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient

PANDA = "pretrained-panda"
PLANE = Path(__file__).parents[2] / "docs" / "images" / "scenario.png"
START = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
GOAL = [0.6, 0.2, 0.0, -1.9, 0.0, 2.1, 0.785]
REACH_OUT = [0.0, 0.5, 0.0, -1.9, 0.0, 2.4, 0.785]
EYE, AIM = (1.25, -0.6, 0.95), (0.3125, 0.103, 0.0126)
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
    assert "the camera sees none of the space that the arm can reach" in problem["detail"]
    assert "z forward" in problem["remedy"]


def test_metres_instead_of_millimetres_are_refused_and_the_unit_is_named(api: ApiClient) -> None:
    answer = ask(api, "/sample", [wall(0, 1)], [RIGHT], **PAGES["/sample"])
    assert "depth_scale_m" in assert_problem(answer, 422, "invalid-image")["remedy"]


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
    narrow = camera_of(camera.matrix, **{name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")})
    depth = np.full((48, 64), 200, np.uint16)
    found = score(api, depth, narrow)
    assert found["scenario"]["novelty"] > 0.9
    assert "little-in-reach" in codes(found)
    plan = ask(api, "/plan", [depth], [narrow], **PAGES["/plan"]).json()
    assert plan["status"] == "refused"
    assert "of the space that the arm can reach" in plan["reason"]
    taken = ask(api, "/plan", [depth], [narrow], **PAGES["/plan"], min_confidence="0.1").json()
    assert taken["status"] == "solved"


@pytest.mark.parametrize("value", [65535, 10001, 19])
def test_what_no_depth_camera_reads_is_no_reading(api: ApiClient, value: int) -> None:
    hole, far = score(api, holed(0)), score(api, holed(value))
    assert (far["confidence"], far["unseen"]) == (hole["confidence"], hole["unseen"])
    assert ("out-of-range" in codes(far), "out-of-range" in codes(hole)) == (True, False)


def test_other_mistakes_are_warnings(api: ApiClient) -> None:
    usual = codes(score(api, wall()))
    assert "focal-lengths" in codes(score(api, wall(), RIGHT | {"fx": 26.0}))
    assert "no-surface-in-reach" in codes(score(api, wall(4500, 7500)))
    # The wall goes through the base, as the front of an arm that is seen does.
    assert usual == ["arm-in-picture"]
    assert "arm-in-picture" not in codes(score(api, wall(), state=json.dumps(START)))
    plan = ask(api, "/plan", [wall()], [RIGHT], **PAGES["/plan"], min_confidence="1").json()
    assert plan["status"] == "refused"
    assert "`state`" in plan["reason"]


def diagnosed(api: ApiClient, camera: DepthCamera = CAMERA, **fields: str) -> httpx.Response:
    values = {name: value for name, value in camera.to_dict().items() if name not in ("width", "height")}
    return ask(api, "/doctor", [PICTURE], [values], **{"state": json.dumps(STATE)} | fields)


def test_a_right_view_has_no_verdicts_and_a_misplaced_camera_a_better_pose(api: ApiClient) -> None:
    answer = diagnosed(api).json()
    assert (answer["verdicts"], answer["poses"]) == ([], [])
    assert any("more unusual than" in note for note in answer["notes"])
    misplaced = CAMERA.matrix
    misplaced[:3, 3] += (0.03, 0.0, 0.0)
    answer = diagnosed(api, replace(CAMERA, pose=pose_of(misplaced))).json()
    (verdict,), (better,) = answer["verdicts"], answer["poses"]
    assert (verdict["code"], verdict["pictures"]) == ("extrinsics", [0])
    assert np.linalg.norm(np.array(better["pose"])[:3, 3] - CAMERA.matrix[:3, 3]) < 0.01
    assert better["offset_m"] == pytest.approx(0.03, abs=0.01)


def test_a_view_that_other_routes_refuse_is_diagnosed(api: ApiClient) -> None:
    turned = replace(CAMERA, pose=pose_of(CAMERA.matrix @ np.diag([1.0, -1.0, -1.0, 1.0])))
    answer = diagnosed(api, turned).json()
    assert {"nothing-in-reach", "opengl-frame", "novel"} <= {one["code"] for one in answer["verdicts"]}
    assert answer["scenario"]["novelty"] == 1.0
    np.testing.assert_allclose(answer["poses"][0]["pose"], CAMERA.matrix, atol=1e-9)


def test_of_a_picture_of_the_plane_the_novelty_alone_is_judged(api: ApiClient) -> None:
    for image, found in ((PLANE.read_bytes(), []), (encode_png(picture()), ["novel"])):
        answer = api.post("/doctor", files={"image": image}, data={"model": "pretrained"}).json()
        assert [one["code"] for one in answer["verdicts"]] == found


def test_what_is_there_is_expected_also_where_no_camera_looks(api: ApiClient) -> None:
    simulator = simulator_of(examples()["panda"])
    scene = simulator.problem("shelf", Split.DEMO, 0).scenario
    answer = api.post("/belief", files={"image": simulator.picture_file(scene)}, data={"model": PANDA}).json()
    occupied = np.frombuffer(base64.b64decode(answer["occupied"]), np.uint8).reshape(answer["counts"]) / 255.0
    low, cell = np.array(answer["low_m"]), answer["cell_m"]
    assert (answer["counts"], cell, low.tolist()) == ([40, 40, 40], 0.05, [-1.0, -1.0, -0.667])
    grid, image = simulator.world.sensor.grid, simulator.world.observed(scene.view())
    # A picture's codes: 0 is seen free; distances in 0.4 mm, at most half a voxel at a surface.
    places = grid.centres_m()[(image[..., 1] > 0) & (image[..., 0] > 31)]
    places = places[np.linalg.norm(places - (0.0, 0.0, 0.333), axis=1) < 0.9]
    distances = distance_m(scene.obstacles, places)
    expected = occupied[tuple(np.floor((places - low) / cell).astype(int).T)]
    within, off = distances < 0.0, distances > 0.1
    assert expected[within].mean() > 10.0 * expected[off].mean()
    assert expected[off].mean() < 0.05
    plane = api.post("/belief", files={"image": PLANE.read_bytes()}, data={"model": "pretrained"})
    assert "an arm that sees with depth cameras" in assert_problem(plane, 422, "invalid-value")["expected"]


@pytest.mark.parametrize("page", ["/belief", "/doctor"])
def test_wrong_requests_are_refused_as_elsewhere(api: ApiClient, page: str) -> None:
    assert_problem(ask(api, page, [wall()], [RIGHT], n="3"), 422, "invalid-value")
    assert_problem(ask(api, page, [wall()], [RIGHT], state="[1.0]"), 422, "invalid-image")
    assert_problem(ask(api, page, [wall()], [RIGHT], robot="0" * 64), 409, "other-robot")


def posed(api: ApiClient, matrix: NDArray[np.float64], **fields: str) -> httpx.Response:
    camera = camera_of(matrix, **{name: getattr(CAMERA, name) for name in ("fx", "fy", "cx", "cy")})
    asked = PAGES["/validity"] | {"state": json.dumps(STATE)} | fields
    return ask(api, "/validity", [PICTURE], [camera], **asked)


def off(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ten degrees off."""
    return make_pose(turn((0.0, 0.0, 1.0), np.radians(10)) @ pose[:3, :3], pose[:3, 3])


@pytest.mark.parametrize(
    ("turned", "words"),
    [
        (np.linalg.inv, "base in the camera"),
        (lambda pose: pose @ np.diag([1.0, -1.0, -1.0, 1.0]), "OpenGL"),
        (order_wxyz, "quaternion"),
        (off, "arm-elsewhere"),
    ],
)
def test_a_pose_by_which_the_arm_is_elsewhere_is_refused_with_its_cause(
    api: ApiClient, turned: Any, words: str
) -> None:
    problem = assert_problem(posed(api, turned(CAMERA.matrix)), 422, "invalid-image")
    assert words in json.dumps(problem)


def test_a_right_pose_is_answered_and_a_wrong_one_where_it_is_not_checked(api: ApiClient) -> None:
    assert posed(api, CAMERA.matrix).status_code == 200
    answer = posed(api, off(CAMERA.matrix), check_pose="false")
    assert answer.status_code == 200
    assert "arm-elsewhere" in codes(answer.json())
