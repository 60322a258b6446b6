"""The Open Inference Protocol's pages: the samples of ``POST /sample``, in the protocol's words."""

import json
from typing import Any

import httpx
import numpy as np
import pytest

from inference_api.limits import MAX_BODY_BYTES
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.tensor_client import (
    IMAGES,
    LENGTH,
    binary_request,
    infer,
    json_input,
    outputs_of,
    sampled,
)


def assert_error(answer: httpx.Response, status: int, word: str = "") -> None:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/json"
    assert set(answer.json()) == {"error"}
    assert word in answer.json()["error"]


def test_the_server_tells_its_name_and_extensions(api: ApiClient) -> None:
    found = api.get("/v2").json()
    assert (found["name"], found["extensions"]) == ("cspace-sampler", ["binary_tensor_data"])
    assert found["version"] == api.get("/openapi.json").json()["info"]["version"]


def test_health_is_told(api: ApiClient) -> None:
    assert api.get("/v2/health/live").json() == {"live": True}
    assert api.get("/v2/health/ready").json() == {"ready": True}
    assert api.get("/v2/models/cspace-sampler@scored/ready").json()["ready"] is True
    assert api.get("/v2/models/cspace-sampler/versions/2/ready").status_code == 200
    assert_error(api.get("/v2/models/nobody/ready"), 404)


def test_without_a_model_the_process_lives_and_is_not_ready(start_api: StartApi) -> None:
    api = start_api(None, shipped=False)
    assert api.get("/v2/health/live").status_code == 200
    for path in ("/v2/health/ready", "/v2/models/cspace-sampler", "/v2/models/cspace-sampler/ready"):
        assert_error(api.get(path), 503, "no model is ready")
    assert_error(infer(api, "cspace-sampler", **binary_request(IMAGES[:1])), 503)


def test_a_model_describes_its_tensors(api: ApiClient) -> None:
    found = api.get("/v2/models/cspace-sampler").json()
    assert found == {
        "name": "cspace-sampler",
        "versions": ["1", "2", "3", "4", "5"],
        "platform": "onnx_onnxv1",
        "inputs": [{"name": "image", "datatype": "UINT8", "shape": [-1, 48, 48, 3]}],
        "outputs": [
            {"name": "samples", "datatype": "FP32", "shape": [-1, 2]},
            {"name": "shortfall", "datatype": "INT32", "shape": [-1]},
            {"name": "seed", "datatype": "UINT64", "shape": [-1]},
        ],
    }
    scored = api.get("/v2/models/cspace-sampler/versions/4").json()
    assert [output["name"] for output in scored["outputs"]] == ["samples", "confidence", "shortfall", "seed"]
    careful = api.get("/v2/models/cspace-sampler@careful").json()["outputs"]
    names = ["samples", "confidence", "shortfall", "novelty", "seed"]
    assert [output["name"] for output in careful] == names
    assert api.get("/v2/models/pretrained/versions/0").json()["versions"] == ["0"]


@pytest.mark.parametrize(("model", "binary"), [("cspace-sampler@challenger", False), ("pretrained", True)])
def test_samples_are_those_of_the_other_page_bit_for_bit(api: ApiClient, model: str, binary: bool) -> None:
    parameters = {"n": 200, "seed": "18446744073709551615", "epsilon_sigma": "[0, 0.5]"}
    if binary:
        answer = infer(
            api, model, **binary_request(IMAGES[:1], parameters={**parameters, "binary_data_output": True})
        )
    else:
        answer = infer(api, model, json={"inputs": [json_input(IMAGES[:1])], "parameters": parameters})
    assert (LENGTH.lower() in answer.headers) is binary
    expected = sampled(api, IMAGES[0], model=model, n=200, seed=parameters["seed"], epsilon_sigma=[0, 0.5])
    found = outputs_of(answer)
    assert found["samples"].tobytes() == np.array(expected["samples"], dtype="<f4").tobytes()
    assert found["seed"].tolist() == [2**64 - 1]
    assert found["shortfall"].tolist() == [0]
    head = json.loads(answer.content[: int(answer.headers.get(LENGTH, len(answer.content)))])
    assert (head["model_name"], head["model_version"]) == (
        expected["model"]["name"],
        str(expected["model"]["version"]),
    )
    assert head["parameters"] == {
        name: expected["model"][name] for name in ("digest", "fallback", "robot", "alias_confirmed")
    }


def test_versions_are_named_in_the_address(api: ApiClient) -> None:
    request = binary_request(IMAGES[:1], parameters={"n": 20, "seed": 3})
    answer = api.post("/v2/models/cspace-sampler/versions/2/infer", **request)
    expected = sampled(api, IMAGES[0], model="cspace-sampler/2", n=20, seed=3)
    assert np.array_equal(outputs_of(answer)["samples"], np.array(expected["samples"], np.float32))
    assert answer.json()["model_version"] == "2"
    zeroth = api.post("/v2/models/pretrained/versions/0/infer", **request)
    assert zeroth.json()["model_version"] == "0"
    assert_error(api.post("/v2/models/cspace-sampler/versions/99/infer", **request), 404)


def test_a_drawn_seed_repeats_its_answer(api: ApiClient) -> None:
    first = outputs_of(infer(api, "cspace-sampler", **binary_request(IMAGES[:1], parameters={"n": 9})))
    seed = str(first["seed"][0])
    again = binary_request(IMAGES[:1], parameters={"n": 9, "seed": seed})
    assert np.array_equal(outputs_of(infer(api, "cspace-sampler", **again))["samples"], first["samples"])


def test_path_models_take_start_and_goal_as_json_in_a_string(api: ApiClient) -> None:
    ends = {"start": "[0.5, -1.0]", "goal": "[1, 2]"}
    request = binary_request(IMAGES[:1], parameters={"n": 20, "seed": 3, **ends})
    found = outputs_of(infer(api, "cspace-sampler@path", **request))
    expected = sampled(
        api, IMAGES[0], model="cspace-sampler@path", n=20, seed=3, start=[0.5, -1.0], goal=[1.0, 2.0]
    )
    assert np.array_equal(found["samples"], np.array(expected["samples"], np.float32))


def test_outputs_come_in_the_order_and_form_that_is_asked_for(api: ApiClient) -> None:
    outputs = [{"name": "seed", "parameters": {"binary_data": False}}, {"name": "samples"}]
    request = binary_request(
        IMAGES[:1], id="42", outputs=outputs, parameters={"n": 3, "seed": 8, "binary_data_output": True}
    )
    answer = infer(api, "cspace-sampler", **request)
    head = json.loads(answer.content[: int(answer.headers[LENGTH])])
    assert head["id"] == "42"
    assert head["outputs"] == [
        {"name": "seed", "datatype": "UINT64", "shape": [1], "data": [8]},
        {"name": "samples", "datatype": "FP32", "shape": [3, 2], "parameters": {"binary_data_size": 24}},
    ]
    assert answer.headers["content-type"] == "application/octet-stream"
    assert len(answer.content) == int(answer.headers[LENGTH]) + 24


WRONG: dict[str, tuple[str, dict[str, Any]]] = {
    "half a sample": ("n", {"parameters": {"n": 1.5}}),
    "endless samples": ("n", {"parameters": {"n": 10**400}}),
    "an endless schedule": ("epsilon_sigma", {"parameters": {"epsilon_sigma": f"[{10**400}]"}}),
    "an endless size": ("image", {"inputs": [{**json_input(IMAGES[:1]), "shape": [10**400, 48, 48, 3]}]}),
    "true samples": ("n", {"parameters": {"n": True}}),
    "an unknown parameter": ("colour", {"parameters": {"colour": "red"}}),
    "a model in the parameters": ("model", {"parameters": {"model": "pretrained"}}),
    "a list as a parameter": ("parameters", {"parameters": {"start": [0, 0]}}),
    "a start for a model that takes none": ("start", {"parameters": {"start": "[0, 0]"}}),
    "a start that is no JSON": ("start", {"parameters": {"start": "[0, 0"}}),
    "a deep start": ("start", {"parameters": {"start": "[" * 50_000}}),
    "a confidence without a head": ("validity head", {"parameters": {"min_confidence": 0.5}}),
    "a flag that is none": ("binary_data_output", {"parameters": {"binary_data_output": 1}}),
    "an output that is not there": ("confidence", {"outputs": [{"name": "confidence"}]}),
    "an output twice": ("samples", {"outputs": [{"name": "samples"}, {"name": "samples"}]}),
    "a classification": ("samples", {"outputs": [{"name": "samples", "parameters": {"classification": 2}}]}),
    "no inputs": ("inputs", {"inputs": []}),
    "another input": ("image", {"inputs": [{**json_input(IMAGES[:1]), "name": "picture"}]}),
    "one input too many": (
        "image",
        {"inputs": [json_input(IMAGES[:1]), {**json_input(IMAGES[:1]), "name": "picture"}]},
    ),
    "another size": ("image", {"inputs": [json_input(IMAGES[:1, :47, :47])]}),
    "another type": ("image", {"inputs": [{**json_input(IMAGES[:1]), "datatype": "INT32"}]}),
    "an unknown member": ("colour", {"colour": "red"}),
    "an id that is no text": ("id", {"id": 3}),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_request_is_400_and_says_what(api: ApiClient, name: str) -> None:
    word, changes = WRONG[name]
    body = {"inputs": [json_input(IMAGES[:1])], **changes}
    assert_error(infer(api, "cspace-sampler", json=body), 400, word)


def test_a_body_that_is_no_json_object_or_no_json_is_refused_and_the_next_one_answered(
    api: ApiClient,
) -> None:
    for content in (b"", b"{", b"[]", b"\xff", b'{"inputs": NaN}', b'{"id": "", "id": ""}'):
        assert_error(infer(api, "cspace-sampler", content=content), 400)
    for headers in ({"content-type": "text/html"}, {"content-encoding": "gzip"}):
        assert_error(infer(api, "cspace-sampler", content=b"{}", headers=headers), 415)
    large = [bytes(2**20)] * (MAX_BODY_BYTES // 2**20) + [b"1"]
    assert_error(infer(api, "cspace-sampler", content=large), 413, "too large")
    assert infer(api, "cspace-sampler", **binary_request(IMAGES[:1])).status_code == 200


def test_many_pictures_share_the_limit_of_samples(api: ApiClient) -> None:
    images = np.repeat(IMAGES[:1], 101, axis=0)
    assert_error(infer(api, "cspace-sampler", **binary_request(images, parameters={"n": 200})), 400, "20000")
    found = outputs_of(infer(api, "cspace-sampler", **binary_request(images[:100], parameters={"n": 200})))
    assert found["samples"].shape == (100, 200, 2)


def test_other_pages_answer_in_the_protocol_s_words_and_those_beside_it_in_their_own(api: ApiClient) -> None:
    statuses = {"nothing": 404, "models/nobody": 404, "models/a@b@c": 400, "models/m/infer": 405}
    for path, status in statuses.items():
        answer = api.get(f"/v2/{path}")
        assert_error(answer, status)
        assert answer.headers.get("allow") == ("POST" if status == 405 else None)
    assert api.get("/v22").headers["content-type"] == "application/problem+json"
    assert api.post("/sample").headers["content-type"] == "application/problem+json"


def test_every_picture_is_answered_as_it_would_be_alone_with_the_next_seed(api: ApiClient) -> None:
    answer = infer(
        api, "cspace-sampler", **binary_request(IMAGES, parameters={"n": 50, "seed": str(2**64 - 2)})
    )
    found = outputs_of(answer)
    assert found["samples"].shape == (3, 50, 2)
    assert found["seed"].tolist() == [2**64 - 2, 2**64 - 1, 0]
    for image, seed, samples in zip(IMAGES, found["seed"].tolist(), found["samples"], strict=True):
        alone = sampled(api, image, n=50, seed=str(seed))["samples"]
        assert np.array_equal(samples, np.array(alone, np.float32))


def test_the_shortfall_is_told_for_each_picture(api: ApiClient) -> None:
    images = np.stack([IMAGES[0], np.zeros_like(IMAGES[0])])
    fields = {"n": 100, "min_confidence": 0.4}
    request = binary_request(images, parameters={**fields, "seed": 5, "binary_data_output": True})
    found = outputs_of(infer(api, "cspace-sampler@scored", **request))
    alone = [
        sampled(api, image, model="cspace-sampler@scored", seed=5 + index, **fields)["shortfall"]
        for index, image in enumerate(images)
    ]
    assert alone[0] < alone[1] == 100
    assert found["shortfall"].tolist() == alone
    assert (found["samples"].shape, found["confidence"].shape) == ((2, 0, 2), (2, 0))


def test_the_novelty_of_each_picture_is_told(api: ApiClient) -> None:
    images = np.stack([np.full((48, 48, 3), level, np.uint8) for level in (150, 255)])
    request = binary_request(images, parameters={"n": 5, "min_confidence": 0})
    fields = {"model": "cspace-sampler@careful", "n": 5, "min_confidence": 0}
    expected = [sampled(api, image, **fields)["scenario"]["novelty"] for image in images]
    assert expected[0] != expected[1]
    for _ in range(2):
        found = outputs_of(infer(api, "cspace-sampler@careful", **request))["novelty"]
        assert found.dtype == np.float32
        assert found.tolist() == pytest.approx(expected)
    assert "novelty" not in outputs_of(infer(api, "cspace-sampler", **request))
