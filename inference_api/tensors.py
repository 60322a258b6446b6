"""Tensors of the Open Inference Protocol: its requests and answers as models, and arrays in their bodies.

Open Inference Protocol v2 over HTTP with the binary tensor data extension: bytes are little-endian, by rows,
in the order of the tensors in the JSON object, whose length ``Inference-Header-Content-Length`` gives.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cspace.errors import InputError
from cspace.world import Finding, TensorInput
from inference_api.models.served import ServedModel
from inference_api.problem_types import MALFORMED_BODY, RequestError, brief, brief_members
from inference_api.requests import load_object
from inference_api.schemas import warnings_of

JSON_LENGTH = "Inference-Header-Content-Length"
DTYPES: dict[str, np.dtype[Any]] = {
    "UINT8": np.dtype("u1"),
    "UINT16": np.dtype("<u2"),
    "INT32": np.dtype("<i4"),
    "INT64": np.dtype("<i8"),
    "UINT64": np.dtype("<u8"),
    "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
}
MAX_RANK = 8
# Of an axis; with the eight that there may be, no product has more than 75 digits.
MAX_SIZE = 2**31 - 1
# Members and list entries at every depth but those in ``data``; sixteen inputs and outputs have about 500.
MAX_MEMBERS = 1_000
_DATATYPES = {dtype: name for name, dtype in DTYPES.items()}
_SIZE, _BINARY = "binary_data_size", "binary_data"
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, protected_namespaces=())

Parameter = bool | int | float | str
Parameters = dict[str, Parameter]
Arrays = Mapping[str, NDArray[Any]]


class InputTensor(BaseModel):
    """A tensor of a request; its numbers are in ``data``, or behind the JSON object."""

    model_config = _STRICT

    name: str = Field(max_length=100)
    datatype: str = Field(max_length=20)
    shape: list[int] = Field(max_length=MAX_RANK)
    parameters: Parameters = Field({}, description="`binary_data_size`, in bytes, for a binary tensor.")
    data: list[Any] | None = Field(None, description="The numbers by rows, flat or nested.")


class RequestedOutput(BaseModel):
    """A tensor that is asked for."""

    model_config = _STRICT

    name: str = Field(max_length=100)
    parameters: Parameters = Field({}, description="`binary_data`: whether it comes as bytes.")


class InferenceRequest(BaseModel):
    """The JSON object of a request; unknown members and parameters are errors."""

    model_config = _STRICT

    id: str | None = Field(None, max_length=1000, description="Comes back in the answer.")
    model_name: str | None = Field(None, description="Not looked at: the address names the model.")
    model_version: str | None = Field(None, description="Not looked at, as `model_name`.")
    parameters: Parameters = Field(
        {},
        description="`n`, `seed`, `min_confidence`, `robot` and `epsilon_sigma` as in `POST /sample`"
        "; `start`, `goal` and several `epsilon_sigma` as a JSON array in a string; "
        "`binary_data_output`: whether outputs come as bytes.",
    )
    inputs: list[InputTensor] = Field(min_length=1, max_length=16)
    outputs: list[RequestedOutput] | None = Field(None, max_length=16, description="All when absent.")


class OutputTensor(BaseModel):
    """A tensor of an answer."""

    name: str
    datatype: str
    shape: list[int]
    parameters: Parameters | None = Field(None, description="`binary_data_size`, in bytes.")
    data: list[float] | None = Field(None, description="The numbers by rows, flat.")


class InferenceAnswer(BaseModel):
    """The JSON object of an answer."""

    model_config = ConfigDict(protected_namespaces=())

    model_name: str
    model_version: str
    id: str | None = None
    parameters: Parameters = Field(
        description="`digest`, `fallback`, `robot` and `alias_confirmed` as in `POST /sample`."
    )
    outputs: list[OutputTensor]


class TensorMetadata(BaseModel):
    """Name, type and shape of a tensor; -1 stands for any size."""

    name: str
    datatype: str
    shape: list[int]


class ModelMetadata(BaseModel):
    """What a model takes and gives."""

    name: str
    versions: list[str]
    platform: str
    inputs: list[TensorMetadata]
    outputs: list[TensorMetadata]


class ServerMetadata(BaseModel):
    """The server."""

    name: str
    version: str
    extensions: list[str]


class ServerLive(BaseModel):
    """The process answers."""

    live: bool = True


class ServerReady(BaseModel):
    """Samples can be asked for."""

    ready: bool = True


class ModelReady(BaseModel):
    """The model can be asked for samples."""

    name: str
    ready: bool = True


class ProtocolError(BaseModel):
    """Why there is no answer."""

    error: str


def inputs_of(tensors: Iterable[TensorInput]) -> list[TensorMetadata]:
    """A model's inputs as its metadata lists them: -1 for an axis of any size."""
    return [
        TensorMetadata(
            name=one.name,
            datatype=_datatype(np.dtype(one.dtype)),
            shape=[-1 if isinstance(size, str) else size for size in one.shape],
        )
        for one in tensors
    ]


def split_body(body: bytes, json_length: str | None) -> tuple[bytes, bytes]:
    """A body's JSON object, and the binary tensors behind it.

    Args:
        body: as it came.
        json_length: value of the header; None when there is none, and then all of the body is JSON.

    Raises:
        RequestError: the header is no length within the body.
    """
    text = str(len(body)) if json_length is None else json_length.strip()
    if not (text.isascii() and text.isdigit() and len(text) <= 20 and int(text) <= len(body)):
        raise RequestError(
            MALFORMED_BODY,
            f"{JSON_LENGTH} is wrong",
            expected=f"a whole number of bytes, at most the body's {len(body)}",
            got=repr(text)[:100],
        )
    return body[: int(text)], body[int(text) :]


def read_request(head: bytes) -> InferenceRequest:
    """Reads a JSON object.

    Raises:
        InputError: a member is wrong, or there are more than :data:`MAX_MEMBERS`.
        RequestError: it is not JSON.
    """
    values = load_object(head)
    _check_members(values)
    try:
        return InferenceRequest.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part)[:100] for part in first["loc"])[:200]
        got = "nothing" if first["type"] == "missing" else brief(first["input"])
        raise InputError(f"{place} is wrong", expected=first["msg"], got=got) from error


def _check_members(values: dict[str, Any]) -> None:
    # Each wrong one would become an error of its own: a second and a GB for an object of 100,000.
    count, waiting = 0, [values]
    while waiting:
        value: object = waiting.pop()
        if not isinstance(value, dict | list):
            continue
        count += len(value)
        if count > MAX_MEMBERS:
            raise InputError(
                "the JSON object has too many members",
                expected=f"at most {MAX_MEMBERS} beside the numbers in data",
                got="more",
            )
        if isinstance(value, dict):
            waiting.extend(inner for name, inner in value.items() if name != "data")
        else:
            waiting.extend(value)


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
            arrays[tensor.name] = _from_json(tensor, tensor.data, dtype)
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


def _from_json(tensor: InputTensor, data: list[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    if tensor.parameters:
        raise _wrong(tensor, "data without parameters", f"both data and {brief_members(tensor.parameters)}")
    # As objects, for numpy would take truth values as numbers and round what is above 2**63.
    try:
        numbers = np.asarray(data, dtype=object)
    except ValueError:
        numbers = np.zeros(0, dtype=object)
    count = math.prod(tensor.shape)
    if numbers.shape not in ((count,), tuple(tensor.shape)):
        raise _wrong(tensor, f"{count} numbers, flat or nested as the shape", f"a {brief(data)}")
    real = dtype.kind == "f"
    bounds = np.finfo(dtype) if real else np.iinfo(dtype)
    # Of Python, for numpy would round what it compares with.
    least, most = (float(bounds.min), float(bounds.max)) if real else (int(bounds.min), int(bounds.max))
    held = set(map(type, numbers.flat)) <= ({int, float} if real else {int})
    if not held or not least <= numbers.min() <= numbers.max() <= most:
        raise _wrong(tensor, f"numbers that {tensor.datatype} holds", "others")
    return numbers.astype(dtype).reshape(tensor.shape)


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


def require_fitting(one: TensorInput, array: NDArray[Any], sizes: dict[str, int]) -> None:
    """Refuses an array that does not follow its description.

    Args:
        one: the description.
        array: what came.
        sizes: of letters that other arrays have fixed; those of this one are kept there.

    Raises:
        InputError: type or shape are others.
    """
    fits = array.dtype == np.dtype(one.dtype).newbyteorder("<") and array.ndim == len(one.shape)
    fits = fits and (not isinstance(one.shape[0], str) or 1 <= array.shape[0] <= one.most)
    if not fits or not all(
        size == (sizes.setdefault(axis, size) if isinstance(axis, str) else axis)
        for axis, size in zip(one.shape, array.shape, strict=True)
    ):
        expected = f"{_datatype(np.dtype(one.dtype))} of shape [{', '.join(map(str, one.shape))}]"
        if isinstance(one.shape[0], str):
            expected += f", {one.shape[0]} from 1 to {one.most}"
        raise InputError(
            f"the input {one.name} does not fit the model",
            expected=expected,
            got=f"{array.dtype} of shape {list(array.shape)}",
            remedy="POST /sample takes PNG files of any size" if one.name == "image" else None,
        )


def write_answer(
    served: ServedModel,
    request: InferenceRequest,
    arrays: Arrays,
    findings: Iterable[Finding],
    *,
    binary: bool,
) -> tuple[bytes, int | None]:
    """A body with the outputs that were asked for, in their order, and the length of its JSON object.

    Args:
        served: the model that answered.
        request: what was asked.
        arrays: every output that there is, by name.
        findings: of the pictures, for the parameter ``warnings``.
        binary: whether outputs come as bytes unless they are asked for otherwise.

    Returns:
        The body, and the length of the JSON object in bytes; None without binary tensors.

    Raises:
        InputError: an output is asked for that is not there, or twice.
    """
    outputs = _requested_outputs(request.outputs, arrays, binary)
    blobs = {name: _little_endian(arrays[name]).tobytes() for name, as_bytes in outputs.items() if as_bytes}
    warnings = [one.model_dump() for one in warnings_of(findings)]
    head = {
        "model_name": served.name,
        "model_version": str(served.version),
        **({} if request.id is None else {"id": request.id}),
        "parameters": {
            "digest": served.bundle.digest,
            "fallback": served.fallback,
            "robot": served.bundle.robot,
            "alias_confirmed": served.confirmed,
            # Parameters of the protocol are no lists.
            **({"warnings": json.dumps(warnings)} if warnings else {}),
        },
        "outputs": [_described(name, arrays[name], blobs.get(name)) for name in outputs],
    }
    # ASCII, for an id may hold what UTF-8 does not have.
    written = json.dumps(head, allow_nan=False).encode("ascii")
    return b"".join([written, *blobs.values()]), len(written) if blobs else None


def _requested_outputs(
    requested: Sequence[RequestedOutput] | None, arrays: Arrays, binary: bool
) -> dict[str, bool]:
    """Names of the outputs in their order, each with whether it comes as bytes."""
    if not requested:
        return dict.fromkeys(arrays, binary)
    outputs: dict[str, bool] = {}
    for output in requested:
        as_bytes = output.parameters.get(_BINARY, binary)
        known = (
            output.name in arrays and output.name not in outputs and not set(output.parameters) - {_BINARY}
        )
        if not known or not isinstance(as_bytes, bool):
            raise InputError(
                f"the output {output.name} cannot be had",
                expected=f"each of {', '.join(arrays)} at most once, with no other parameter than {_BINARY}, "
                "true or false",
                got=f"parameters {brief_members(output.parameters)}"[:200],
                remedy="confidence is there for models with a validity head, novelty for those that tell it",
            )
        outputs[output.name] = as_bytes
    return outputs


def _described(name: str, array: NDArray[Any], blob: bytes | None) -> dict[str, Any]:
    described = {"name": name, "datatype": _datatype(array.dtype), "shape": list(array.shape)}
    contents = {"data": array.ravel().tolist()} if blob is None else {"parameters": {_SIZE: len(blob)}}
    return described | contents


def _datatype(dtype: np.dtype[Any]) -> str:
    return _DATATYPES[dtype.newbyteorder("<")]


def _little_endian(array: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
