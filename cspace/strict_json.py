"""Strict JSON: a text to plain values, these to frozen dataclasses by the types of their fields, and back."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from numbers import Real
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from cspace.errors import CspaceError

Kind = TypeVar("Kind")
# As seeds are unsigned.
_LARGEST = 2**64 - 1
MAX_DEPTH = 64
_SHOWN = 200
_NAMES = {str: "a text", bool: "true or false", int: "a whole number", float: "a finite number"}


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


def parse_json(
    data: bytes, *, whole: Callable[[str], int] = _whole, number: Callable[[str], float] = _finite
) -> object:
    """The values of a text in UTF-8 without NaN, infinity, or a key twice in one object.

    Args:
        data: the text; its size is the caller's to bound.
        whole: reads whole numbers; without it they have at most 64 bits.
        number: reads the others; without it they are finite.

    Raises:
        ValueError: it is not that, or nested deeper than 64 levels.
    """
    try:
        values = json.loads(
            data.decode("utf-8"),
            parse_constant=_refuse,
            parse_int=whole,
            parse_float=number,
            object_pairs_hook=_unique,
        )
    except RecursionError as error:
        raise ValueError(str(error)) from error
    # What the parser takes may still be too deep for whoever shows or writes it.
    if data.count(b"[") + data.count(b"{") > MAX_DEPTH:
        _check_depth(values)
    return values


def json_text(values: object, what: str, open_to: str, error: type[CspaceError]) -> str:
    """The text of plain values, keys in order.

    Args:
        values: what :func:`written` gave.
        what: its name in messages.
        open_to: the part of it that takes any values.
        error: the kind of error.

    Raises:
        error: something in it is not plain, or no finite number.
    """
    try:
        return json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as problem:
        raise error(
            f"{what} is not plain JSON",
            expected="finite numbers, texts, lists and mappings",
            got=str(problem)[:_SHOWN],
            remedy=f"convert arrays, paths and NaN before they enter the {open_to}",
        ) from problem


def read_mapping(values: object, where: str, error: type[CspaceError]) -> dict[str, Any]:
    """The members of an object, whatever they are.

    Raises:
        error: it is none; ``where`` is its name in the message.
    """
    if not isinstance(values, Mapping):
        raise _wrong("an object", values, where, error)
    return dict(values)


def read_members(values: object, keys: set[str], where: str, error: type[CspaceError]) -> dict[str, Any]:
    """The members of an object that has exactly the given keys.

    Raises:
        error: it is no such object; ``where`` is its name in the message.
    """
    members = read_mapping(values, where, error)
    if set(members) != keys:
        missing, unknown = sorted(keys - set(members)), sorted(map(str, set(members) - keys))
        raise error(
            f"{where} has other keys",
            expected=f"exactly {sorted(keys)}",
            got=f"missing {missing}, unknown {unknown}"[:_SHOWN],
        )
    return members


def read_object(kind: type[Kind], values: object, where: str, error: type[CspaceError]) -> Kind:
    """A frozen dataclass of an object that has exactly its fields as keys; the inverse of :func:`written`.

    Fields are texts, truths, whole and finite numbers, tuples (lists in JSON), mappings of texts, any plain
    value, other such dataclasses, or one of these or None. ``Annotated[X, read]`` is read by ``read``, which
    judges by itself. Nothing is converted but whole numbers where others belong.

    Raises:
        error: a key or a value does not fit; ``where`` is the object's name in the message.
    """
    types = _types(kind)  # type: ignore[arg-type] # every class is hashable
    members = read_members(values, set(types), where, error)
    return kind(
        **{name: _read(types[name], value, f"{where}: {name}", error) for name, value in members.items()}
    )


def written(value: object) -> dict[str, Any]:
    """A dataclass as plain values for JSON; what has a ``to_dict`` in its fields tells itself by that."""
    return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}  # type: ignore[arg-type]


def settle(value: object) -> None:
    """Within ``__post_init__`` of a frozen dataclass: whole numbers where finite ones belong become these.

    Lists become tuples. So a value is equal to what is read of the JSON that it writes.
    """
    for name, kind in _types(type(value)).items():  # type: ignore[arg-type] # every class is hashable
        object.__setattr__(value, name, _settled(kind, getattr(value, name)))


def _settled(kind: Any, value: Any) -> Any:
    parts = tuple(part for part in get_args(kind) if part is not NoneType)
    if isinstance(value, bool):
        # A whole number to Python, and to nobody else.
        return value
    if kind is float and isinstance(value, Real):
        return float(value)
    if get_origin(kind) in (Union, UnionType) and len(parts) == 1:
        return _settled(parts[0], value)
    if get_origin(kind) is tuple and isinstance(value, tuple | list):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) == len(value):
            return tuple(_settled(one, item) for one, item in zip(kinds, value, strict=True))
    return value


def _plain(value: Any) -> Any:
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if is_dataclass(value):
        return written(value)
    if isinstance(value, Mapping):
        return dict(value)
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


@cache
def _types(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _read(kind: Any, value: Any, where: str, error: type[CspaceError]) -> Any:
    if kind in _NAMES:
        return _read_scalar(kind, value, where, error)
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return parts[1](value)
    if origin in (Union, UnionType):
        known = next(part for part in parts if part is not NoneType)
        return None if value is None else _read(known, value, where, error)
    if origin is tuple:
        return _read_list(parts, value, where, error)
    if origin is Mapping:
        members = read_mapping(value, where, error)
        return {key: _read(parts[1], item, where, error) for key, item in members.items()}
    # Nothing else is left but Any.
    return read_object(kind, value, where, error) if is_dataclass(kind) else value  # type: ignore[arg-type]


def _read_list(parts: tuple[Any, ...], value: Any, where: str, error: type[CspaceError]) -> tuple[Any, ...]:
    length = None if parts[-1] is Ellipsis else len(parts)
    if not isinstance(value, list) or length not in (None, len(value)):
        raise _wrong("a list" if length is None else f"a list of {length}", value, where, error)
    kinds = parts[:1] * len(value) if length is None else parts
    return tuple(_read(kind, item, where, error) for kind, item in zip(kinds, value, strict=True))


def _read_scalar(kind: type, value: Any, where: str, error: type[CspaceError]) -> Any:
    if kind is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if kind is float or type(value) is not kind:
        raise _wrong(_NAMES[kind], value, where, error)
    return value


def _wrong(expected: str, got: object, where: str, error: type[CspaceError]) -> CspaceError:
    return error(f"{where} does not fit", expected=expected, got=repr(got)[:_SHOWN])


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
