"""Field values to a valid request, with messages in the contract's words."""

from collections.abc import Mapping
from itertools import islice
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from inference_api.failures import FieldProblem, FieldsError
from inference_api.pages.schemas import RequestFields, SampleRequest

Fields = TypeVar("Fields", bound=RequestFields)

MAX_REPORTED = 8
_SHOWN_BITS = 128


def validate_request(values: Mapping[str, Any]) -> SampleRequest:
    """Check the field values of a whole request.

    Raises:
        FieldsError: a field is unknown, missing or wrong.
    """
    return validate_fields(SampleRequest, values)


def validate_fields(kind: type[Fields], values: Mapping[str, Any]) -> Fields:
    """Check field values.

    Raises:
        FieldsError: a field is unknown, missing or wrong.
    """
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        told = kind.EXPECTED
        places: dict[int | str, int] = {name: place for place, name in enumerate(told)}

        def place(item: ErrorDetails) -> int:
            return places.get(item["loc"][0] if item["loc"] else "", len(places))

        found = sorted(error.errors(include_url=False, include_context=False), key=place)[:MAX_REPORTED]
        raise FieldsError(
            [_field_problem(item["type"], item["loc"], item["input"], told) for item in found]
        ) from error


def _field_problem(
    kind: str, location: tuple[int | str, ...], value: object, told: Mapping[str, str]
) -> FieldProblem:
    field = str(location[0])[:100] if location else ""
    if kind == "extra_forbidden":
        expected = f"one of {', '.join(told)}"
        return FieldProblem(field=field, expected=expected, got="an unknown field")
    got = "nothing" if kind == "missing" else brief(value)
    return FieldProblem(field=field, expected=told.get(field, "another value"), got=got)


def brief(value: object) -> str:
    """A short description of an untrusted value; never walks into it, however deep or long it is."""
    if isinstance(value, bytes | list | dict):
        return f"{type(value).__name__} of length {len(value)}"
    if isinstance(value, int) and value.bit_length() > _SHOWN_BITS:
        # Its digits might be more than Python turns into text.
        return f"a whole number of {value.bit_length()} bits"
    return repr(value[:100] if isinstance(value, str) else value)[:120]


def brief_members(values: Mapping[str, object]) -> str:
    """The same for an object's first members."""
    shown = [f"{brief(name)}: {brief(value)}" for name, value in islice(values.items(), 3)]
    return ", ".join([*shown, "..."] if len(values) > len(shown) else shown) or "none"
