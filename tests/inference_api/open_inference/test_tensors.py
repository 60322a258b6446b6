"""Bodies of the Open Inference Protocol: hand-written ones, round trips, and bytes that mean no good."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pydantic import ValidationError

from cspace.errors import CspaceError, InputError
from inference_api.models.served import ServedModel
from inference_api.problem_types import RequestError
from inference_api.tensors import (
    DTYPES,
    InferenceRequest,
    InputTensor,
    read_tensors,
    split_body,
    write_answer,
)

BINARY = {"binary_data": True}
NAMES = {dtype: name for name, dtype in DTYPES.items()}
KINDS = st.sampled_from([np.dtype("u1"), np.dtype("<i4"), np.dtype("<u8"), np.dtype("<f4")])
SHAPES = arrays.array_shapes(min_dims=0, max_dims=4, min_side=1, max_side=4)


def values(kind: np.dtype[Any]) -> st.SearchStrategy[Any]:
    return arrays.from_dtype(kind, allow_nan=False, allow_infinity=False)


ARRAYS = KINDS.flatmap(lambda kind: arrays.arrays(kind, SHAPES, elements=values(kind)))
SENT = st.lists(st.tuples(ARRAYS, st.booleans()), max_size=4)


def described(name: str, array: np.ndarray, binary: bool) -> dict[str, Any]:
    entry = {"name": name, "datatype": NAMES[array.dtype], "shape": list(array.shape)}
    if binary:
        return entry | {"parameters": {"binary_data_size": array.nbytes}}
    return entry | {"data": array.tolist() if array.ndim else [array.item()]}


def test_the_header_tells_where_the_json_object_ends_and_without_it_all_is_json() -> None:
    assert split_body(b'{"inputs": []}', None) == (b'{"inputs": []}', b"")
    assert split_body(b"{}\x01\x02", "2") == (b"{}", b"\x01\x02")
    for length in ("5", "-1", "", "2.0", "two", "²", "1" * 30, "+2"):
        with pytest.raises(RequestError, match="Inference-Header-Content-Length"):
            split_body(b"{}\x01\x02", length)


MODEL = ServedModel(SimpleNamespace(digest="d", robot="r"), "m", 3)  # type: ignore[arg-type]


def written(arrays: dict[str, np.ndarray], outputs: list[dict[str, Any]]) -> tuple[dict[str, Any], bytes]:
    """The JSON object and the bytes of an answer with these outputs."""
    tensor = {"name": "t", "datatype": "UINT8", "shape": [1]}
    request = InferenceRequest.model_validate({"inputs": [tensor], "outputs": outputs})
    content, length = write_answer(MODEL, request, arrays, (), binary=False)
    assert (length is None) is not any(one.get("parameters") for one in outputs)
    return json.loads(content[:length]), content[len(content) if length is None else length :]


def test_tensors_are_written_by_hand_computed_bytes() -> None:
    arrays = {
        "a": np.array([[1.0, -2.0]], dtype=np.float32),
        "b": np.array([7], np.int32),
        "c": np.array([2**64 - 1], np.uint64),
    }
    outputs = [{"name": "a", "parameters": BINARY}, {"name": "b"}, {"name": "c", "parameters": BINARY}]
    head, tail = written(arrays, outputs)
    assert (head["model_name"], head["model_version"]) == ("m", "3")
    assert head["outputs"] == [
        {"name": "a", "datatype": "FP32", "shape": [1, 2], "parameters": {"binary_data_size": 8}},
        {"name": "b", "datatype": "INT32", "shape": [1], "data": [7]},
        {"name": "c", "datatype": "UINT64", "shape": [1], "parameters": {"binary_data_size": 8}},
    ]
    assert tail == b"\0\0\x80\x3f\0\0\0\xc0" + b"\xff" * 8


def test_an_array_of_another_byte_order_or_by_columns_is_sent_as_the_protocol_has_it() -> None:
    array = np.asfortranarray(np.array([[1, 2], [3, 4]], dtype=">i4"))
    _, tail = written({"a": array}, [{"name": "a", "parameters": BINARY}])
    assert tail == b"\x01\0\0\0\x02\0\0\0\x03\0\0\0\x04\0\0\0"


@given(SENT)
def test_requests_with_nested_numbers_and_bytes_are_read(sent: list[tuple[np.ndarray, bool]]) -> None:
    entries = [described(f"t{index}", array, binary) for index, (array, binary) in enumerate(sent)]
    tail = b"".join(array.tobytes() for array, binary in sent if binary)
    found = read_tensors([InputTensor.model_validate(entry) for entry in entries], tail)
    assert all(np.array_equal(got, array) for got, (array, _) in zip(found.values(), sent, strict=True))


@given(st.binary(max_size=200), st.one_of(st.none(), st.text(max_size=5), st.integers(-5, 250).map(str)))
def test_splitting_loses_nothing_or_is_refused(body: bytes, length: str | None) -> None:
    try:
        parts = split_body(body, length)
    except RequestError:
        return
    assert parts[0] + parts[1] == body


JSON = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**70), 2**70),
        st.just(10**400),
        st.floats(allow_nan=False),
        st.text(),
    ),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=12,
)


@given(
    st.sampled_from(["UINT8", "INT32", "UINT64", "FP32", "BYTES", "FP64", ""]),
    st.lists(st.one_of(st.integers(-2, 5), st.just(2**62)), max_size=9),
    st.one_of(st.none(), st.lists(JSON, max_size=6)),
    st.one_of(st.none(), st.integers(-2, 50), st.booleans(), st.just(2**63)),
    st.binary(max_size=50),
)
def test_no_described_tensor_ends_in_another_error_than_ours(
    datatype: str, shape: list[int], data: list[Any] | None, size: int | None, tail: bytes
) -> None:
    parameters = {} if size is None else {"binary_data_size": size}
    entry = {"name": "t", "datatype": datatype, "shape": shape, "data": data, "parameters": parameters}
    try:
        found = read_tensors([InputTensor.model_validate(entry)], tail)
    except (CspaceError, ValidationError):
        return
    assert list(found["t"].shape) == shape
    assert found["t"].nbytes == len(tail) or data is not None


WRONG: dict[str, tuple[dict[str, Any], bytes]] = {
    "too few bytes": ({"shape": [3], "parameters": {"binary_data_size": 3}}, b"\0\0"),
    "too many bytes": ({"shape": [3], "parameters": {"binary_data_size": 3}}, b"\0\0\0\0"),
    "another size than the shape's": ({"shape": [3], "parameters": {"binary_data_size": 2}}, b"\0\0"),
    "true as a size": ({"shape": [1], "parameters": {"binary_data_size": True}}, b"\0"),
    "neither data nor bytes": ({"shape": [1]}, b""),
    "shared memory": ({"shape": [1], "parameters": {"shared_memory_region": "x"}}, b""),
    "both data and bytes": ({"shape": [1], "data": [1], "parameters": {"binary_data_size": 1}}, b"\0"),
    "too few numbers": ({"shape": [3], "data": [1, 2]}, b""),
    "another nesting": ({"shape": [2, 1], "data": [[1, 2]]}, b""),
    "ragged": ({"shape": [3], "data": [[1, 2], [3]]}, b""),
    "ragged in depth": ({"shape": [2, 2], "data": [[1, 2], [3, [4]]]}, b""),
    "half nested": ({"shape": [2, 2], "data": [1, 2, 3, [4]]}, b""),
    "nested where it is flat": ({"shape": [4], "data": [[1, 2], [3, 4]]}, b""),
    "too little nested": ({"shape": [1, 1, 1], "data": [[5]]}, b""),
    "nested where there is one": ({"shape": [], "data": [[5]]}, b""),
    "nothing in a list": ({"shape": [1], "data": [[]]}, b""),
    "above the type": ({"shape": [1], "data": [256]}, b""),
    "below the type": ({"shape": [1], "data": [-1]}, b""),
    "a fraction": ({"shape": [1], "data": [1.5]}, b""),
    "a truth": ({"shape": [1], "data": [True]}, b""),
    "text": ({"shape": [1], "data": ["1"]}, b""),
    "null": ({"shape": [1], "data": [None]}, b""),
    "huge": ({"shape": [1], "data": [2**70]}, b""),
    "longer than any float": ({"shape": [1], "data": [10**400], "datatype": "FP32"}, b""),
    "above the floats of 32 bits": ({"shape": [1], "data": [-3.5e38], "datatype": "FP32"}, b""),
    "an empty one": ({"shape": [0], "data": []}, b""),
    "nothing times a lot": ({"shape": [0, 2**62], "parameters": {"binary_data_size": 0}}, b""),
    "a negative size": ({"shape": [-1, -1], "data": [1]}, b""),
    "an unknown type": ({"shape": [1], "data": [1], "datatype": "INT7"}, b""),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_tensor_that_does_not_fit_is_refused(name: str) -> None:
    changes, tail = WRONG[name]
    with pytest.raises(InputError):
        read_tensors([InputTensor.model_validate({"name": "t", "datatype": "UINT8", **changes})], tail)


def test_a_name_that_comes_twice_is_refused() -> None:
    tensor = InputTensor(name="t", datatype="UINT8", shape=[1], data=[1])
    with pytest.raises(InputError, match="repeated"):
        read_tensors([tensor, tensor], b"")
