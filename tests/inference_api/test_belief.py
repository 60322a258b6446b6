"""``POST /belief``: how likely something is in each cell of space, seen or not."""

import base64
import json
from pathlib import Path

import httpx
import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace_client import DepthPictures, SamplerAnswerError, SamplingClient
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.client_transports import IntoApp

PANDA = "pretrained-panda"
PLANE = Path(__file__).parents[2] / "docs" / "images" / "scenario.png"
SIMULATOR = simulator_of(examples()["panda"])
SCENE = SIMULATOR.problem("shelf", Split.DEMO, 0).scenario


@pytest.fixture(scope="module")
def api(panda_api: ApiClient) -> ApiClient:
    return panda_api


def ask(api: ApiClient, **fields: str) -> httpx.Response:
    data = {"model": PANDA, **fields}
    return api.post("/belief", files={"image": SIMULATOR.picture_file(SCENE)}, data=data)


def cells_of(answer: dict) -> np.ndarray:
    found = np.frombuffer(base64.b64decode(answer["occupied"]), np.uint8)
    return found.reshape(answer["counts"]) / 255.0


def test_what_is_there_is_expected_also_where_no_camera_looks(api: ApiClient) -> None:
    answer = ask(api).json()
    occupied, low, cell = cells_of(answer), np.array(answer["low_m"]), answer["cell_m"]
    assert (answer["counts"], cell, low.tolist()) == ([40, 40, 40], 0.05, [-1.0, -1.0, -0.667])
    places, distances = SIMULATOR.unseen_places(SCENE)
    expected = occupied[tuple(np.floor((places - low) / cell).astype(int).T)]
    within, off = distances < 0.0, distances > 0.1
    assert expected[within].mean() > 10.0 * expected[off].mean()
    assert expected[off].mean() < 0.05


def test_wrong_requests_are_refused_as_elsewhere(api: ApiClient) -> None:
    assert_problem(ask(api, n="3"), 422, "invalid-value")
    assert_problem(ask(api, robot="0" * 64), 409, "other-robot")
    plane = api.post("/belief", files={"image": PLANE.read_bytes()}, data={"model": "pretrained"})
    assert "an arm that sees with depth cameras" in assert_problem(plane, 422, "invalid-value")["expected"]


def pictures() -> DepthPictures:
    view = SCENE.view()
    cameras = [
        {name: one.to_dict()[name] for name in ("fx", "fy", "cx", "cy", "pose")} for one in view.cameras
    ]
    return DepthPictures(view.pictures, cameras, view.states)


def test_the_client_reads_a_belief(api: ApiClient) -> None:
    with SamplingClient("http://localhost", 30.0, transport=IntoApp(api)) as client:
        found = client.belief(pictures(), PANDA)
    answer = ask(api).json()
    np.testing.assert_allclose(found.occupied, cells_of(answer), atol=1e-6)
    assert (found.model.model_name, found.model.novelty) == (PANDA, answer["scenario"]["novelty"])
    sure = found.centres_m(0.5)
    assert len(sure) == (cells_of(answer) >= 0.5).sum()
    assert ((sure > found.low_m) & (sure < found.low_m + 40 * found.cell_m)).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"counts": [40, 40, 41]},
        {"counts": [-40, -40, 40]},
        {"counts": []},
        {"occupied": "@"},
        {"low_m": [0.0]},
    ],
)
def test_the_client_refuses_what_is_no_belief(api: ApiClient, wrong: dict) -> None:
    answer = ask(api)
    body = json.dumps(answer.json() | wrong)

    def reply(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, content=body, headers={"content-type": "application/json"})

    with (
        SamplingClient("http://localhost", 30.0, transport=httpx.MockTransport(reply)) as client,
        pytest.raises(SamplerAnswerError, match="is no belief"),
    ):
        client.belief(pictures(), PANDA)
