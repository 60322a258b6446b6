"""Strict JSON: a text to plain values, and these to pydantic dataclasses that raise the project's errors."""

import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import field
from functools import cache, wraps
from typing import Annotated, Any, TypeVar, cast, dataclass_transform

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import ErrorDetails, to_jsonable_python

from cspace.errors import CspaceError

Kind = TypeVar("Kind")
_Number = TypeVar("_Number", int, float)
# As seeds are unsigned.
_LARGEST = 2**64 - 1
MAX_DEPTH = 64
_SHOWN = 200
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
# In the place of pydantic's own words.
_EXPECTED = {
    "string_type": "a text",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a finite number",
    "dataclass_type": "an object",
    "model_type": "an object",
    "greater_than": "above {gt:.10g}",
    "greater_than_equal": "at least {ge:.10g}",
    "less_than": "below {lt:.10g}",
    "less_than_equal": "at most {le:.10g}",
}


def _whole(text: str) -> int:
    value = int(text) if len(text) <= len(str(-_LARGEST)) else _LARGEST + 1
    if abs(value) > _LARGEST:
        raise ValueError(f"{text[:_SHOWN]} has more than 64 bits")
    return value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:_SHOWN]} is not finite")
    return value


def parse_json(data: bytes, *, whole: Callable[[str], int] = _whole) -> object:
    """The values of a text in UTF-8 without NaN, infinity, or a key twice in one object.

    Args:
        whole: reads whole numbers; without it they have at most 64 bits.
    """
    try:
        values = json.loads(
            data.decode("utf-8"),
            parse_constant=_refuse,
            parse_int=whole,
            parse_float=_finite,
            object_pairs_hook=_unique,
        )
    except RecursionError as error:
        raise ValueError(str(error)) from error
    # What the parser takes may still be too deep for whoever shows or writes it.
    if data.count(b"[") + data.count(b"{") > MAX_DEPTH:
        _check_depth(values)
    return values


def json_text(values: object, what: str, open_to: str, error: type[CspaceError]) -> str:
    """The text of plain values, keys in order."""
    try:
        return json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as problem:
        raise error(
            f"{what} is not plain JSON",
            expected="finite numbers, texts, lists and mappings",
            got=str(problem)[:_SHOWN],
            remedy=f"convert arrays, paths and NaN before they enter the {open_to}",
        ) from problem


def _in_order(span: tuple[_Number, _Number]) -> tuple[_Number, _Number]:
    if span[0] > span[1]:
        raise ValueError("a range from low to high")
    return span


Span = Annotated[tuple[_Number, _Number], AfterValidator(_in_order)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
# Of a field that is not written where it is None, and may be missing then.
LEFT_OUT = Field(exclude_if=lambda value: value is None)


def first_of(problem: ValidationError) -> ErrorDetails:
    """The first of pydantic's errors; of unknown keys before others, for a missing one may be misspelt."""
    wrong = problem.errors(include_url=False)
    return next((one for one in wrong if one["type"] in _UNKNOWN), wrong[0])


def refused(
    problem: ValidationError, error: type[CspaceError], where: str, remedy: str | None = None
) -> CspaceError:
    """The project's error for the first of pydantic's, or for the project's own that a validator raised."""
    first = first_of(problem)
    context = first.get("ctx", {})
    own = context.get("error")
    if isinstance(own, error):
        return own
    if isinstance(own, CspaceError):
        return error(f"{where}: {own.what}", expected=own.expected, got=own.got, remedy=own.remedy or remedy)
    path, kind = ".".join(map(str, first["loc"]))[:_SHOWN], first["type"]
    place = f"{where}: {path}" if path else where
    if kind == "missing":
        return error(f"{place} is missing", expected="a value", got="nothing", remedy=remedy)
    if kind in _UNKNOWN:
        return error(f"{place} is unknown", expected="known keys alone", got=path, remedy=remedy)
    words = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    expected = _EXPECTED[kind].format(**context) if kind in _EXPECTED else words
    return error(f"{place} does not fit", expected=expected, got=repr(first["input"])[:_SHOWN], remedy=remedy)


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
    """A value of a type that pydantic knows, of plain values; the inverse of :func:`written`.

    Nothing is converted but whole numbers where others belong, and lists to tuples. Every key has to be
    there that is always written, for defaults are for code: a file without one is damaged, or another
    release's.
    """
    try:
        found: Kind = adapter_of(kind).validate_json(json.dumps(values, default=repr), strict=True)  # type: ignore[arg-type] # every class is hashable
    except ValidationError as problem:
        raise refused(problem, error, where) from problem
    for place in _missing(found, values):
        raise error(f"{where}: {place} is missing", expected="a value", got="nothing")
    return found


def written(value: object) -> dict[str, Any]:
    """A dataclass as plain values for JSON."""
    return cast("dict[str, Any]", to_jsonable_python(value))


@cache
def adapter_of(kind: Any) -> TypeAdapter[Any]:
    """Pydantic's adapter of a type, built once."""
    return TypeAdapter(kind)


def _missing(found: Any, values: Any) -> Iterator[str]:
    """Keys that every file has, of what was read and of what it was read from."""
    for name, info in getattr(found, "__pydantic_fields__", {}).items():
        if name in values:
            yield from (f"{name}.{rest}" for rest in _missing(getattr(found, name), values[name]))
        elif info.exclude_if is None:
            yield name
    if isinstance(found, tuple):
        for index, pair in enumerate(zip(found, values, strict=True)):
            yield from (f"{index}.{rest}" for rest in _missing(*pair))


def _check_depth(values: object) -> None:
    level = [values]
    for _ in range(MAX_DEPTH):
        level = [
            part
            for one in level
            for part in (one.values() if isinstance(one, dict) else one if isinstance(one, list) else ())
            if isinstance(part, dict | list)
        ]
        if not level:
            return
    raise ValueError(f"it is nested deeper than {MAX_DEPTH} levels")


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        raise ValueError("a key stands twice in one object")
    return values
