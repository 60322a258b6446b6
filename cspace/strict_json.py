"""Untrusted JSON, and pydantic dataclasses that raise the project's errors."""

import json
import re
from collections.abc import Callable
from dataclasses import field
from functools import cache, wraps
from typing import Annotated, Any, TypeVar, cast, dataclass_transform

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import from_json, to_jsonable_python

from cspace.errors import CspaceError

Kind = TypeVar("Kind")
_Number = TypeVar("_Number", int, float)
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


def parse_json(data: bytes | str) -> Any:
    """The values of a text of a bounded size, at most 200 levels deep; a ValueError where it is no JSON."""
    return from_json(data, allow_inf_nan=False)


def json_text(values: object) -> str:
    """The text of plain values, keys in order."""
    return json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"


def _in_order(span: tuple[_Number, _Number]) -> tuple[_Number, _Number]:
    if span[0] > span[1]:
        raise ValueError("a range from low to high")
    return span


Span = Annotated[tuple[_Number, _Number], AfterValidator(_in_order)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
# Of a field that is not written where it is None, and may be missing then.
LEFT_OUT = Field(exclude_if=lambda value: value is None)


def refused(
    problem: ValidationError, error: type[CspaceError], where: str, remedy: str | None = None
) -> CspaceError:
    """The project's error for the first of pydantic's, or for the project's own that a validator raised."""
    wrong = problem.errors(include_url=False)
    # A missing key may be one that is misspelt.
    first = next((one for one in wrong if one["type"] in _UNKNOWN), wrong[0])
    own = first.get("ctx", {}).get("error")
    if isinstance(own, error):
        return own
    if isinstance(own, CspaceError):
        return error(f"{where}: {own.what}", expected=own.expected, got=own.got, remedy=own.remedy or remedy)
    path = ".".join(map(str, first["loc"]))[:200]
    place = f"{where}: {path}" if path else where
    if first["type"] == "missing":
        return error(f"{place} is missing", expected="a value", got="nothing", remedy=remedy)
    if first["type"] in _UNKNOWN:
        return error(f"{place} is unknown", expected="known keys alone", got=path, remedy=remedy)
    expected = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    return error(f"{place} does not fit", expected=expected, got=repr(first["input"])[:200], remedy=remedy)


@dataclass_transform(frozen_default=True, field_specifiers=(field, Field))
def validated(error: type[CspaceError]) -> Callable[[type[Kind]], type[Kind]]:
    """A decorator: a frozen pydantic dataclass whose constructor raises the project's error.

    Lists become tuples, and whole numbers become floats where these belong, so that a value is equal to what
    is read of the JSON that it writes.
    """

    def decorate(kind: type[Kind]) -> type[Kind]:
        made: Any = dataclass(frozen=True, slots=True, config=_CONFIG)(kind)
        construct, names = made.__init__, list(made.__dataclass_fields__)
        where = "the " + re.sub("(?<=[a-z])(?=[A-Z])", " ", kind.__name__).lower()

        @wraps(construct)
        def init(self: Any, *values: Any, **named: Any) -> None:
            try:
                # By name, as pydantic would give the position of a value as its place.
                construct(self, *values[len(names) :], **dict(zip(names, values, strict=False)), **named)
            except ValidationError as problem:
                raise refused(problem, error, where) from problem

        made.__init__ = init
        return cast("type[Kind]", made)

    return decorate


class Record:
    """Base of validated dataclasses that files hold."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return written(self)


def read_object(kind: type[Kind], values: object, where: str, error: type[CspaceError]) -> Kind:
    """A value of a type that pydantic knows, of plain values; only whole numbers and lists are converted."""
    try:
        text = json.dumps(values, default=repr)
        return cast("Kind", adapter_of(kind).validate_json(text, strict=True))  # type: ignore[arg-type] # hashable
    except ValidationError as problem:
        raise refused(problem, error, where) from problem


def read_json(data: bytes, where: str, error: type[CspaceError]) -> dict[str, Any]:
    """The members of an untrusted JSON object of a bounded size."""
    try:
        values = parse_json(data)
    except ValueError as problem:
        raise error(f"{where} is not JSON", expected="UTF-8 JSON", got=str(problem)[:200]) from problem
    return read_object(dict[str, Any], values, where, error)


def written(value: object) -> dict[str, Any]:
    """A dataclass as plain values for JSON."""
    return cast("dict[str, Any]", to_jsonable_python(value))


@cache
def adapter_of(kind: Any) -> TypeAdapter[Any]:
    """Pydantic's adapter of a type, built once."""
    return TypeAdapter(kind)
