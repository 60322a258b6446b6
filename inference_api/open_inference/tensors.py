"""Tensors in bodies of the Open Inference Protocol: as JSON numbers, or as bytes behind the JSON object.

Open Inference Protocol v2 over HTTP with the binary tensor data extension: bytes are little-endian, by rows,
in the order of the tensors in the JSON object, whose length ``Inference-Header-Content-Length`` gives.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import InputError
from inference_api.open_inference.tensor_schemas import InputTensor
from inference_api.pages.validation import brief, brief_members
from inference_api.problems import MALFORMED_BODY, RequestError

JSON_LENGTH = "Inference-Header-Content-Length"
DTYPES: dict[str, np.dtype[Any]] = {
    "UINT8": np.dtype("u1"),
    "UINT16": np.dtype("<u2"),
    "INT32": np.dtype("<i4"),
    "UINT64": np.dtype("<u8"),
    "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
}
# Of an axis; with the eight that there may be, no product has more than 75 digits.
MAX_SIZE = 2**31 - 1
_DATATYPES = {dtype: name for name, dtype in DTYPES.items()}
_SIZE = "binary_data_size"


@dataclass(frozen=True, slots=True)
class SplitBody:
    """A body's two parts.

    Args:
        head: the JSON object.
        tail: the binary tensors, one behind the other.
    """

    head: bytes
    tail: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Tensor:
    """A tensor that is to be sent.

    Args:
        name: of the output.
        array: float32, int32, uint64 or uint8 of any shape.
        binary: whether it is sent as bytes.
    """

    name: str
    array: NDArray[Any]
    binary: bool


@dataclass(frozen=True, slots=True)
class WrittenBody:
    """A body that is to be sent.

    Args:
        content: the JSON object and the binary tensors.
        json_length: length of the JSON object in bytes; None without binary tensors.
    """

    content: bytes
    json_length: int | None


def split_body(body: bytes, json_length: str | None) -> SplitBody:
    """Cut a body behind its JSON object.

    Args:
        body: as it came.
        json_length: value of the header; None when there is none, and then all of the body is JSON.

    Raises:
        RequestError: the header is no length within the body.
    """
    if json_length is None:
        return SplitBody(body, b"")
    text = json_length.strip()
    fits = text.isascii() and text.isdigit() and len(text) <= 20
    if not fits or int(text) > len(body):
        raise RequestError(
            MALFORMED_BODY,
            f"{JSON_LENGTH} is wrong",
            expected=f"a whole number of bytes, at most the body's {len(body)}",
            got=repr(text)[:100],
        )
    return SplitBody(body[: int(text)], body[int(text) :])


def read_tensors(inputs: Sequence[InputTensor], tail: bytes) -> dict[str, NDArray[Any]]:
    """The arrays that a request describes, by name.

    Args:
        inputs: in the order in which the binary ones lie in ``tail``.
        tail: the binary tensors' bytes, all of which must be used.

    Raises:
        InputError: a name comes twice, a tensor is empty, or type, shape, size and contents do not fit
            each other.
    """
    arrays: dict[str, NDArray[Any]] = {}
    at = 0
    for tensor in inputs:
        if tensor.name in arrays:
            raise InputError(f"the input {tensor.name} is repeated", expected="one", got="several")
        dtype = DTYPES.get(tensor.datatype)
        if dtype is None or not all(1 <= size <= MAX_SIZE for size in tensor.shape):
            raise _wrong(tensor, f"one of {', '.join(DTYPES)} with sizes from 1 to {MAX_SIZE}", "another")
        if tensor.data is not None:
            arrays[tensor.name] = _from_json(tensor, dtype)
        else:
            size = _binary_size(tensor, dtype, len(tail) - at)
            count = size // dtype.itemsize
            arrays[tensor.name] = np.frombuffer(tail, dtype, count, at).reshape(tensor.shape)
            at += size
    if at != len(tail):
        raise InputError(
            "the binary tensors do not fill the body",
            expected=f"{len(tail)} bytes behind the JSON object",
            got=f"inputs of {at} bytes",
        )
    return arrays


def write_tensors(head: Mapping[str, Any], tensors: Sequence[Tensor]) -> WrittenBody:
    """The body with the JSON object ``head``, to which the member ``outputs`` is added, and the tensors."""
    blobs = [_little_endian(tensor.array).tobytes() if tensor.binary else None for tensor in tensors]
    outputs = [_describe(tensor, blob) for tensor, blob in zip(tensors, blobs, strict=True)]
    # ASCII, for an id may hold what UTF-8 does not have.
    written = json.dumps({**head, "outputs": outputs}, allow_nan=False).encode("ascii")
    tail = [blob for blob in blobs if blob is not None]
    return WrittenBody(b"".join([written, *tail]), len(written) if tail else None)


def datatype_of(array: NDArray[Any]) -> str:
    """The protocol's name of an array's type."""
    return datatype_named(array.dtype.name)


def datatype_named(name: str) -> str:
    """The protocol's name of a type that has one of numpy's."""
    return _DATATYPES[np.dtype(name).newbyteorder("<")]


def _describe(tensor: Tensor, blob: bytes | None) -> dict[str, Any]:
    array = tensor.array
    described = {"name": tensor.name, "datatype": datatype_of(array), "shape": list(array.shape)}
    contents = {"data": array.ravel().tolist()} if blob is None else {"parameters": {_SIZE: len(blob)}}
    return described | contents


def _little_endian(array: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def _from_json(tensor: InputTensor, dtype: np.dtype[Any]) -> NDArray[Any]:
    data = tensor.data or []
    if tensor.parameters:
        raise _wrong(tensor, "data without parameters", f"both data and {brief_members(tensor.parameters)}")
    numbers = _by_rows(data, tensor.shape)
    if numbers is None:
        count = math.prod(tensor.shape)
        raise _wrong(tensor, f"{count} numbers, flat or nested as the shape", f"a {brief(data)}")
    if not _holds(dtype, numbers):
        raise _wrong(tensor, f"numbers that {tensor.datatype} holds", "others")
    return np.array(numbers, dtype).reshape(tensor.shape)


def _by_rows(data: list[Any], shape: Sequence[int]) -> list[Any] | None:
    """The values of a list that is flat or nested as a shape; None where it is neither."""
    if len(data) == math.prod(shape) and not isinstance(data[0], list):
        return data
    level: list[Any] = [data]
    for size in shape:
        if not all(isinstance(inner, list) and len(inner) == size for inner in level):
            return None
        level = list(chain.from_iterable(level))
    return level


def _holds(dtype: np.dtype[Any], numbers: list[Any]) -> bool:
    """Whether values from JSON, one or more, are numbers that a type holds."""
    real = dtype.kind == "f"
    if not set(map(type, numbers)) <= ({int, float} if real else {int}):
        return False
    # As Python's numbers: NumPy's cannot be compared to whole numbers of any length.
    largest = float(np.finfo(dtype).max) if real else int(np.iinfo(dtype).max)
    least = -largest if real else int(np.iinfo(dtype).min)
    return bool(least <= min(numbers) and max(numbers) <= largest)


def _binary_size(tensor: InputTensor, dtype: np.dtype[Any], left: int) -> int:
    size = tensor.parameters.get(_SIZE)
    expected = math.prod(tensor.shape) * dtype.itemsize
    if set(tensor.parameters) != {_SIZE} or isinstance(size, bool) or size != expected:
        got = f"parameters {brief_members(tensor.parameters)}"[:200]
        raise _wrong(tensor, f"data, or {_SIZE} {expected} as the shape needs and nothing else", got)
    if expected > left:
        raise _wrong(tensor, f"{expected} bytes behind the JSON object", f"{left}")
    return expected


def _wrong(tensor: InputTensor, expected: str, got: str) -> InputError:
    shape = f"[{', '.join(map(brief, tensor.shape))}]"[:100]
    return InputError(
        f"the input {tensor.name} of type {tensor.datatype} and shape {shape} is wrong",
        expected=expected[:200],
        got=got,
    )
