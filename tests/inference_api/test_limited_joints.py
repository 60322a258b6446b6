"""Models of limited arms behind the API: what answers say of the joint space, and what they refuse."""

import base64
from dataclasses import asdict

import numpy as np
import pytest

from cspace.png import encode_png
from cspace.space import circles
from cspace.worlds.planar.arm import PlanarArm
from cspace_client.answers import read_headers, read_samples
from cspace_client.models import ModelHead
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from tests.bundles import picture, write_tiny_bundle
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import running

NPY = "application/x-npy"
ROBOT = PlanarArm(joint_limits_rad=((-2.9, 4.0), None))
JSON = {
    "image": base64.b64encode(encode_png(picture())).decode(),
    "n": 2000,
    "seed": 1,
    "start": [3.9, 7.0],
    "goal": [-2.0, 0.0],
}


@pytest.fixture(scope="module")
def api(tmp_path_factory):
    folder = tmp_path_factory.mktemp("api")
    shipped = write_tiny_bundle(folder / "bundle", ROBOT, kind="path", scale=4.0)
    settings = ApiSettings(registry_uri=None, cache_folder=folder / "cache", pretrained_folder=shipped)
    with running(create_app(settings, None)) as client:
        yield client


def test_answers_tell_the_limits_and_keep_them(api):
    body = api.post("/sample", json=JSON).json()
    assert body["joint_space"] == {
        "kind": "mixed", "dim": 2, "unit": "rad",
        "lower": [-2.9, -np.pi], "upper": [4.0, np.pi], "periodic": [False, True],
    }  # fmt: skip
    samples = np.float32(body["samples"])
    assert ROBOT.space.holds(samples).all()
    assert (samples[:, 0] > np.pi).any()


def test_the_client_reads_the_same_from_the_array_and_its_header(api):
    answer = api.post("/sample", json=JSON, headers={"accept": NPY})
    space = read_headers(ModelHead, answer.headers)["space"]
    expected = {name: value for name, value in asdict(ROBOT.space).items() if name != "names"}
    assert asdict(space) == expected
    samples = read_samples(answer.content, JSON["n"], space)
    np.testing.assert_array_equal(samples, np.float32(api.post("/sample", json=JSON).json()["samples"]))


def test_an_end_outside_the_limits_is_a_problem_that_says_both(api):
    problem = assert_problem(api.post("/sample", json=JSON | {"goal": [4.1, 0.0]}), 422, "invalid-value")
    assert "goal lies outside the limits" in problem["detail"]
    assert "4.1" in problem["got"]
    assert "-2.9" in problem["expected"]


def test_the_document_describes_both_kinds_of_joint_space(api):
    schemas = api.get("/openapi.json").json()["components"]["schemas"]
    assert schemas["JointSpaceInfo"]["properties"]["kind"]["const"] == "torus"
    assert set(schemas["JointSpaceInfo"]["properties"]) == set(circles(1).to_dict())
    assert set(schemas["LimitedJointSpaceInfo"]["required"]) == set(ROBOT.space.to_dict())
