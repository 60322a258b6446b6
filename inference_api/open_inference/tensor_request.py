"""The JSON object of a request of the Open Inference Protocol, from bytes to checked members and fields."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from cspace.errors import InputError
from inference_api.bodies.bounded_json import MAX_TENSOR_MARKS, load_json, parse_json
from inference_api.open_inference.tensor_schemas import InferenceRequest, Parameter
from inference_api.pages.validation import brief

# Members and list entries at every depth but those in ``data``; sixteen inputs and outputs have about 500.
MAX_MEMBERS = 1_000
# Characters of a parameter that is text, as many as bytes of a form's field.
MAX_TEXT = 64 * 1024
_ARRAYS = ("epsilon_sigma", "start", "goal")
_FIELDS = ("n", "seed", "min_confidence", "robot", *_ARRAYS)
_ALL_BINARY = "binary_data_output"


def read_request(head: bytes) -> InferenceRequest:
    """Read a JSON object.

    Raises:
        InputError: a member is wrong, or there are more than :data:`MAX_MEMBERS`.
        RequestError: it is not strict JSON, or has more than :data:`MAX_TENSOR_MARKS` marks.
    """
    values = parse_json(head, MAX_TENSOR_MARKS)
    _check_members(values)
    try:
        return InferenceRequest.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part)[:100] for part in first["loc"])[:200]
        got = "nothing" if first["type"] == "missing" else brief(first["input"])
        raise InputError(f"{place} is wrong", expected=first["msg"], got=got) from error


def split_parameters(parameters: Mapping[str, Parameter]) -> tuple[bool, dict[str, object]]:
    """Whether outputs come as bytes by default, and the fields of a request for samples.

    Raises:
        InputError: a parameter is unknown, too long, or no flag where one is expected.
        RequestError: one that is an array is not JSON.
    """
    unknown = sorted(set(parameters) - {*_FIELDS, _ALL_BINARY})
    if unknown:
        known = f"one of {', '.join((*_FIELDS, _ALL_BINARY))}"
        raise InputError("a parameter is unknown", expected=known, got=repr(unknown[0][:100])[:100])
    binary = flag(_ALL_BINARY, parameters.get(_ALL_BINARY, False))
    fields: dict[str, object] = {name: value for name, value in parameters.items() if name != _ALL_BINARY}
    for name, value in fields.items():
        if isinstance(value, str):
            fields[name] = _from_text(name, value)
    return binary, fields


def flag(name: str, value: Parameter) -> bool:
    """A parameter that is true or false.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, bool):
        raise InputError(f"{name} is wrong", expected="true or false", got=brief(value))
    return value


def _from_text(name: str, text: str) -> object:
    if len(text) > MAX_TEXT:
        raise InputError(f"{name} is too long", expected=f"at most {MAX_TEXT} characters", got=f"{len(text)}")
    return load_json(name, text.encode("utf-8", errors="replace")) if name in _ARRAYS else text


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
