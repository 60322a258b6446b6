"""Numbers, sizes and texts of tensor requests that are larger than anything that they could mean."""

from typing import Any

import numpy as np

from cspace.worlds.planar.world import MAX_PICTURES
from inference_api.requests import MAX_FIELD_BYTES
from inference_api.tensors import MAX_MEMBERS, MAX_SIZE, read_request
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import IMAGES, binary_request, infer, json_input, outputs_of

HUGE = 10**900


def wrong(api: ApiClient, **members: Any) -> str:
    answer = infer(api, "cspace-sampler", json={"inputs": [json_input(IMAGES[:1])], **members})
    assert answer.status_code == 400, answer.text
    assert len(answer.content) < 2000
    error: str = answer.json()["error"]
    return error


def test_sizes_that_are_too_large_are_refused(api: ApiClient) -> None:
    for shape in ([HUGE] * 8, [HUGE, HUGE], [MAX_SIZE + 1], [-HUGE, 1]):
        for contents in ({"data": [1]}, {"parameters": {"binary_data_size": 1}}):
            tensor = {"name": "image", "datatype": "UINT8", "shape": shape, **contents}
            assert str(MAX_SIZE) in wrong(api, inputs=[tensor])


def test_two_sizes_of_4000_digits_are_refused(api: ApiClient) -> None:
    shape = b"[%b, %b]" % (b"9" * 4000, b"9" * 4000)
    for contents in (b'"data": [1]', b'"parameters": {"binary_data_size": 1}'):
        body = b'{"inputs": [{"name": "image", "datatype": "UINT8", "shape": %b, %b}]}' % (shape, contents)
        assert infer(api, "cspace-sampler", content=body).status_code == 400


def test_the_largest_sizes_make_no_number_too_long_to_tell(api: ApiClient) -> None:
    tensor = {
        "name": "image",
        "datatype": "FP32",
        "shape": [MAX_SIZE] * 8,
        "parameters": {"binary_data_size": 4},
    }
    assert "as the shape needs" in wrong(api, inputs=[tensor])


def test_a_request_has_at_most_256_pictures(api: ApiClient) -> None:
    images = np.repeat(IMAGES[:1], MAX_PICTURES + 1, axis=0)
    few = infer(api, "cspace-sampler", **binary_request(images[:-1], parameters={"n": 1}))
    assert outputs_of(few)["samples"].shape == (MAX_PICTURES, 1, 2)
    many = infer(api, "cspace-sampler", **binary_request(images, parameters={"n": 1}))
    assert many.status_code == 400
    assert str(MAX_PICTURES) in many.json()["error"]


def test_texts_of_parameters_are_bounded(api: ApiClient) -> None:
    for name in ("epsilon_sigma", "start", "goal", "seed", "n"):
        assert f"{name} is too long" in wrong(api, parameters={name: " " * (MAX_FIELD_BYTES + 1)})
        assert name in wrong(api, parameters={name: "[" + "0," * 20_000 + "0]"})


def test_members_beside_the_numbers_are_bounded(api: ApiClient) -> None:
    assert "too many members" in wrong(api, parameters={f"k{index}": [] for index in range(MAX_MEMBERS)})
    tensor = json_input(IMAGES[:1])
    assert "too many members" in wrong(api, inputs=[{**tensor, "shape": [[]] * MAX_MEMBERS}])
    assert "too many members" in wrong(api, outputs=[{"name": "samples"}] * MAX_MEMBERS)
    head = b'{"inputs": [{"name": "t", "datatype": "UINT8", "shape": [9], "data": [%b0]}]}' % (b"0," * 5000)
    assert len(read_request(head).inputs[0].data or []) == 5001
