"""``POST /doctor``: verdicts, notes and suggested poses for the pictures of a request."""

import json
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest

from cspace.png import encode_png
from cspace.worlds.spatial.camera import DepthCamera, encode_depth
from cspace.worlds.spatial.poses import pose_of
from cspace_client import DepthPictures, SamplingClient
from tests.bundles import picture
from tests.cspace.worlds.spatial.test_doctor import CAMERA, PICTURE, STATE, VIEW, WORLD
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.client_transports import IntoApp

PANDA = "pretrained-panda"
SCENARIO = Path(__file__).parents[2] / "docs" / "images" / "scenario.png"
MISPLACED = CAMERA.matrix
MISPLACED[:3, 3] += (0.03, 0.0, 0.0)


@pytest.fixture(scope="module")
def api(panda_api: ApiClient) -> ApiClient:
    return panda_api


def ask(api: ApiClient, camera: DepthCamera = CAMERA, **fields: str) -> httpx.Response:
    values = {name: value for name, value in camera.to_dict().items() if name not in ("width", "height")}
    data = {"model": PANDA, "camera": json.dumps(values), "state": json.dumps(STATE), **fields}
    return api.post("/doctor", files=[("image", encode_depth(PICTURE))], data=data)


def test_a_right_view_has_no_verdicts_and_its_novelty(api: ApiClient) -> None:
    answer = ask(api).json()
    assert (answer["verdicts"], answer["poses"]) == ([], [])
    assert 0.0 <= answer["scenario"]["novelty"] <= 1.0
    assert any("more unusual than" in note for note in answer["notes"])
    assert answer["model"]["name"] == PANDA


def test_a_misplaced_camera_has_a_verdict_and_a_better_pose(api: ApiClient) -> None:
    answer = ask(api, replace(CAMERA, pose=pose_of(MISPLACED))).json()
    (verdict,) = answer["verdicts"]
    assert verdict["code"] == "extrinsics"
    assert verdict["pictures"] == [0]
    assert "suggested pose" in verdict["remedy"]
    (better,) = answer["poses"]
    assert np.linalg.norm(np.array(better["pose"])[:3, 3] - CAMERA.matrix[:3, 3]) < 0.01
    assert better["offset_m"] == pytest.approx(0.03, abs=0.01)


def test_a_view_that_other_routes_refuse_is_diagnosed(api: ApiClient) -> None:
    body = replace(CAMERA, pose=pose_of(CAMERA.matrix @ np.diag([1.0, -1.0, -1.0, 1.0])))
    answer = ask(api, body).json()
    assert {"nothing-in-reach", "opengl-frame"} <= {one["code"] for one in answer["verdicts"]}
    assert answer["scenario"]["novelty"] is None
    np.testing.assert_allclose(answer["poses"][0]["pose"], CAMERA.matrix, atol=1e-9)


def test_wrong_requests_are_refused_as_elsewhere(api: ApiClient) -> None:
    assert_problem(ask(api, n="3"), 422, "invalid-value")
    assert_problem(ask(api, state="[1.0]"), 422, "invalid-image")
    assert_problem(ask(api, robot="0" * 64), 409, "other-robot")


def test_of_a_picture_of_the_plane_the_novelty_alone_is_judged(api: ApiClient) -> None:
    for image, codes in (
        (SCENARIO.read_bytes(), []),
        (encode_png(picture()), ["novel"]),
    ):
        answer = api.post("/doctor", files={"image": image}, data={"model": "pretrained"}).json()
        assert [one["code"] for one in answer["verdicts"]] == codes


def test_a_diagnosis_ends_where_the_client_has_left() -> None:
    class LeftError(Exception):
        pass

    calls = 0

    def check_cancelled() -> None:
        nonlocal calls
        calls += 1
        if calls == 60:
            raise LeftError

    with pytest.raises(LeftError):
        WORLD.diagnosed(VIEW, check_cancelled)


def test_the_client_reads_a_diagnosis(api: ApiClient) -> None:
    camera_values = {
        name: value for name, value in CAMERA.to_dict().items() if name not in ("width", "height", "pose")
    }
    shown = DepthPictures([PICTURE], [camera_values | {"pose": MISPLACED}], np.array(STATE))
    with SamplingClient("http://localhost", 30.0, transport=IntoApp(api)) as client:
        found = client.doctor(shown, PANDA)
    assert [one.code for one in found.verdicts] == ["extrinsics"]
    assert found.verdicts[0].pictures == (0,)
    assert np.linalg.norm(found.poses[0].pose[:3, 3] - CAMERA.matrix[:3, 3]) < 0.01
    assert found.model.model_name == PANDA
    assert found.model.novelty is not None
    assert found.notes
