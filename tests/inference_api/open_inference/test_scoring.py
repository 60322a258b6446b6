"""Configurations that are asked about by the Open Inference Protocol, in a picture that is seen whole."""

import base64
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from cspace.png import encode_png
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import IMAGES, infer, json_input, outputs_of

MODEL = "cspace-sampler@careful"
ROWS = np.random.default_rng(0).uniform(-np.pi, np.pi, (30, 2)).astype("<f4")


def tensor(rows: NDArray[Any], datatype: str) -> dict[str, Any]:
    """Configurations as an input with JSON numbers."""
    return {
        "name": "configurations",
        "datatype": datatype,
        "shape": list(rows.shape),
        "data": rows.ravel().tolist(),
    }


def ask(
    api: ApiClient,
    rows: NDArray[Any] = ROWS,
    images: NDArray[np.uint8] = IMAGES[:1],
    model: str = MODEL,
    datatype: str = "FP32",
    **members: Any,
) -> httpx.Response:
    """The answer to a question about configurations."""
    return infer(api, model, json={"inputs": [json_input(images), tensor(rows, datatype)], **members})


def test_confidences_are_those_of_the_other_page(api: ApiClient) -> None:
    image = base64.b64encode(encode_png(IMAGES[0])).decode()
    fields = {"image": image, "configurations": ROWS.tolist(), "model": MODEL}
    other = api.post("/validity", json=fields).json()
    found = outputs_of(ask(api))
    assert set(found) == {"confidence", "novelty"}
    np.testing.assert_array_equal(found["confidence"], np.float32(other["confidence"]))
    assert len(set(found["confidence"].tolist())) > 1


def test_the_outputs_that_are_asked_for_come_in_their_form(api: ApiClient) -> None:
    requested = [{"name": "confidence", "parameters": {"binary_data": True}}]
    found = outputs_of(ask(api, outputs=requested))
    assert list(found) == ["confidence"]
    np.testing.assert_array_equal(found["confidence"], outputs_of(ask(api))["confidence"])
    answer = ask(api, outputs=[{"name": "samples"}])
    assert answer.status_code == 400
    assert "the output samples cannot be had" in answer.json()["error"]


def test_another_robot_and_parameters_of_samples_are_refused(api: ApiClient) -> None:
    for parameter in ({"n": 5}, {"seed": 1}, {"min_confidence": 0.5}):
        answer = ask(api, parameters=parameter)
        assert answer.status_code == 400
        assert "does not go with the input configurations" in answer.json()["error"]
    assert ask(api, parameters={"robot": "0" * 64}).status_code == 409


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "rows of another robot": ({"rows": np.zeros((4, 3), "<f4")}, "the input configurations does not fit"),
    "no rows": ({"rows": np.zeros((0, 2), "<f4")}, "sizes from 1"),
    "one row alone": ({"rows": np.zeros(2, "<f4")}, "the input configurations does not fit"),
    "too many rows": ({"rows": np.zeros((20001, 2), "<f4")}, "n from 1 to 20000"),
    "another type": ({"datatype": "FP64"}, "expected FP32 of shape [n, 2], n from 1 to 20000"),
    "several pictures": ({"images": IMAGES}, "configurations are scored in one picture"),
    "a model without a head": ({"model": "cspace-sampler"}, "head"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_scored_is_told(api: ApiClient, name: str) -> None:
    wrong, message = WRONG[name]
    answer = ask(api, **wrong)
    assert answer.status_code == 400
    assert message in answer.json()["error"]
