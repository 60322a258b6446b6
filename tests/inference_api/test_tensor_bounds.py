"""Numbers, sizes and texts of tensor requests that are larger than anything that they could mean."""

from typing import Any

import numpy as np
import pytest

from cspace.errors import InputError
from cspace.worlds.planar.world import MAX_PICTURES
from inference_api.problem_types import brief, brief_members
from inference_api.requests import MAX_FIELD_BYTES
from inference_api.tensors import MAX_MEMBERS, MAX_SIZE, InputTensor, read_request, read_tensors
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import IMAGES, binary_request, infer, json_input, outputs_of

HUGE = 10**900


def wrong(api: ApiClient, **members: Any) -> str:
    answer = infer(api, "cspace-sampler", json={"inputs": [json_input(IMAGES[:1])], **members})
    assert answer.status_code == 400, answer.text
    assert len(answer.content) < 2000
    error: str = answer.json()["error"]
    return error


@pytest.mark.parametrize(
    "shape", [[HUGE] * 8, [HUGE, HUGE], [MAX_SIZE + 1], [-HUGE, 1]], ids=lambda shape: f"{len(shape)}"
)
@pytest.mark.parametrize(
    "contents", [{"data": [1]}, {"parameters": {"binary_data_size": 1}}], ids=["data", "bytes"]
)
def test_sizes_that_are_too_large_are_refused(
    api: ApiClient, shape: list[int], contents: dict[str, Any]
) -> None:
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


@pytest.mark.parametrize("name", ["epsilon_sigma", "start", "goal", "seed", "n"])
def test_texts_of_parameters_are_bounded(api: ApiClient, name: str) -> None:
    assert f"{name} is too long" in wrong(api, parameters={name: " " * (MAX_FIELD_BYTES + 1)})
    assert name in wrong(api, parameters={name: "[" + "0," * 20_000 + "0]"})


def test_members_beside_the_numbers_are_bounded(api: ApiClient) -> None:
    assert "too many members" in wrong(api, parameters={f"k{index}": [] for index in range(MAX_MEMBERS)})
    tensor = json_input(IMAGES[:1])
    assert "too many members" in wrong(api, inputs=[{**tensor, "shape": [[]] * MAX_MEMBERS}])
    assert "too many members" in wrong(api, outputs=[{"name": "samples"}] * MAX_MEMBERS)
    head = b'{"inputs": [{"name": "t", "datatype": "UINT8", "shape": [9], "data": [%b0]}]}' % (b"0," * 5000)
    assert len(read_request(head).inputs[0].data or []) == 5001


def test_a_number_of_any_length_is_described_in_a_line() -> None:
    assert brief(-12) == "-12"
    assert brief(value=True) == "True"
    for number in (10**5000, -(10**100_000)):
        assert "bits" in brief(number)
    shown = brief_members({"a" * 500: 10**5000, "b": "c" * 10**6, "d": [1], "e": 3})
    assert len(shown) < 600
    assert shown.endswith("'d': list of length 1, ...")
    assert brief_members({}) == "none"


def test_floats_may_lie_at_any_byte_of_the_body() -> None:
    tensors = [
        InputTensor(name="a", datatype="UINT8", shape=[1], parameters={"binary_data_size": 1}),
        InputTensor(name="b", datatype="FP32", shape=[2], parameters={"binary_data_size": 8}),
    ]
    found = read_tensors(tensors, b"\7\0\0\x80\x3f\0\0\0\xc0")
    assert (found["a"].tolist(), found["b"].tolist()) == ([7], [1.0, -2.0])


@pytest.mark.parametrize(
    ("shape", "data", "fits"),
    [
        ([], [5], True),
        ([], [[5]], False),
        ([1, 1, 1], [5], True),
        ([1, 1, 1], [[[5]]], True),
        ([1, 1, 1], [[5]], False),
        ([2, 2], [[1, 2], [3, 4]], True),
        ([2, 2], [[1, 2], [3, [4]]], False),
        ([2, 2], [[1, 2], 3], False),
        ([2, 2], [1, 2, 3, [4]], False),
        ([4], [[1, 2], [3, 4]], False),
        ([1], [[]], False),
        ([1], [], False),
    ],
)
def test_numbers_are_flat_or_nested_as_the_shape(shape: list[int], data: list[Any], fits: bool) -> None:
    tensor = InputTensor(name="t", datatype="INT32", shape=shape, data=data)
    if not fits:
        with pytest.raises(InputError):
            read_tensors([tensor], b"")
        return
    assert read_tensors([tensor], b"")["t"].shape == tuple(shape)
