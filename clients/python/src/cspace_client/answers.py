"""Reads a stranger's answers: JSON, headers and .npy bodies, each checked before use."""

import json
import math
import re
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, astuple, fields
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from cspace_client.errors import printable, unusable
from cspace_client.models import (
    MAX_LIMIT_RAD,
    JointSpace,
    ModelHead,
    SampleBatch,
    SourceTiming,
    Wire,
    circles,
)

Kind = TypeVar("Kind")
_Reader = Callable[[Any, Any, str], Any]
"""Of a type, a value of JSON, and where it stands, for the error."""
_MAX_TEXT = 1000
_DIGITS = re.compile("[0-9]{1,20}")


def parse_object(body: bytes, what: str) -> dict[str, Any]:
    """The members of an object in JSON.

    Args:
        body: of an answer.
        what: it stands for, for the error, as "plan".

    Raises:
        SamplerAnswerError: it is none.
    """
    try:
        values = _parse_json(body)
    except ValueError as error:
        raise unusable(f"is no {what}", "JSON", str(error)) from error
    if not isinstance(values, dict):
        raise unusable(f"is no {what}", "an object", repr(values)[:80])
    return values


def read_object(kind: type[Kind], members: Mapping[str, Any], what: str, **given: Any) -> Kind:
    """An object of JSON as a dataclass, by the types of its fields and what :class:`Wire` says of them.

    Members that the class does not know are left out, and absent ones are as null.

    Args:
        kind: the dataclass.
        members: of the object.
        what: it stands for, for the error.
        given: fields that do not come from the object.

    Raises:
        SamplerAnswerError: a member is missing or wrong.
    """
    try:
        found: Kind = _read_fields(kind, members, "", given)
    except ValueError as error:
        # The error says all that its cause would.
        raise unusable(f"is no {what}", f"the members of a {what}", str(error)) from None
    return found


def read_headers(kind: Any, headers: Mapping[str, str]) -> dict[str, Any]:
    """Those fields of a dataclass that headers tell, by name; an absent header is left to the default.

    Args:
        kind: the dataclass.
        headers: of the answer; names in any case if the mapping does not mind it.

    Raises:
        SamplerAnswerError: a header is missing or wrong.
    """
    found: dict[str, Any] = {}
    try:
        for name, hint, wire, required in _fields(kind):
            if not wire.header or not (required or wire.header in headers):
                continue
            value: Any = headers.get(wire.header)
            # Texts have a pattern; all others are JSON.
            if value is not None and not wire.pattern:
                value = _parse_header(wire.header, value)
            found[name] = _read(hint, value, f"header {wire.header}")
    except ValueError as error:
        raise unusable("has wrong headers", "those of an inference API", str(error)) from None
    return found


def _parse_json(text: bytes | str) -> Any:
    try:
        return json.loads(text, parse_constant=_refuse)
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error


def _parse_header(name: str, text: str) -> Any:
    with suppress(ValueError):
        if (value := _parse_json(text)) is not None:
            return value
    return _wrong(f"header {name}", "JSON", text)


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


@cache
def _fields(kind: Any) -> list[tuple[str, Any, Wire, bool]]:
    """Name, type, :class:`Wire` and whether there is no default, of each field of a dataclass."""
    hints = get_type_hints(kind, include_extras=True)
    return [
        (
            one.name,
            hints[one.name],
            next((note for note in get_args(hints[one.name])[1:] if isinstance(note, Wire)), Wire()),
            one.default is MISSING,
        )
        for one in fields(kind)
    ]


def _read_fields(kind: Any, members: Any, where: str, given: Mapping[str, Any]) -> Any:
    found = dict(given)
    for name, hint, wire, required in _fields(kind):
        if name in given:
            continue
        value, place = members, wire.at or name
        for part in place.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if required or value is not None:
            found[name] = _read(hint, value, f"{where}{place}")
    return kind(**found)


def _read(hint: Any, value: object, where: str) -> Any:
    """A value of JSON as a type.

    Raises:
        ValueError: it is none of that type.
    """
    read: _Reader = _READERS.get(get_origin(hint) or hint, _read_nested)
    return read(hint, value, where)


def _read_nested(hint: Any, value: object, where: str) -> Any:
    return _read_fields(hint, value, f"{where}.", {})


def _read_bounded(hint: Any, value: object, where: str) -> Any:
    """Of ``Annotated``: a value within what its :class:`Wire` allows."""
    kind, wire = get_args(hint)
    found = _read(kind, value, where)
    if found is None:
        return None
    # As it came: what can not be printed is replaced in what was read.
    if wire.pattern and re.fullmatch(wire.pattern, str(value)) is None:
        _wrong(where, f"a text as {wire.pattern}", value)
    if wire.most < math.inf and not np.all((np.asarray(found) >= 0.0) & (np.asarray(found) <= wire.most)):
        _wrong(where, f"0 to {wire.most:g}", value)
    return found


def _read_optional(hint: Any, value: object, where: str) -> Any:
    return None if value is None else _read(get_args(hint)[0], value, where)


def _read_choice(hint: Any, value: object, where: str) -> Any:
    return value if value in get_args(hint) else _wrong(where, f"one of {get_args(hint)}", value)


def _read_tuple(hint: Any, value: object, where: str) -> tuple[Any, ...]:
    kind, *others = get_args(hint)
    if not isinstance(value, list) or (others != [...] and len(value) != 1 + len(others)):
        _wrong(where, f"a list for {hint}", value)
    return tuple(_read(kind, one, where) for one in value)


def _read_array(hint: Any, value: object, where: str) -> NDArray[Any]:
    (dtype,) = get_args(get_args(hint)[1])
    # Lists of different lengths make no array.
    with suppress(ValueError), np.errstate(over="ignore"):
        numbers = np.asarray(value)
        if isinstance(value, list) and numbers.dtype.kind in "iuf":
            numbers = numbers.astype(dtype)
            if np.isfinite(numbers).all():
                return numbers
    return _wrong(where, "finite numbers", value)


def _read_mapping(_: Any, value: object, where: str) -> dict[str, Any]:
    return value if isinstance(value, dict) else _wrong(where, "an object", value)


def _read_text(_: Any, value: object, where: str) -> str:
    return printable(value, _MAX_TEXT) if isinstance(value, str) else _wrong(where, "a text", value)


def _read_flag(_: Any, value: object, where: str) -> bool:
    return value if isinstance(value, bool) else _wrong(where, "true or false", value)


def _read_whole(_: Any, value: object, where: str) -> int:
    # Seeds are texts, for many readers of JSON keep no 64 bits of a number.
    if isinstance(value, str) and _DIGITS.fullmatch(value):
        return int(value)
    return value if type(value) is int and value >= 0 else _wrong(where, "a whole number from 0", value)


def _read_number(_: Any, value: Any, where: str) -> float:
    fits = type(value) in (int, float) and abs(value) <= sys.float_info.max
    return float(value) if fits else _wrong(where, "a finite number", value)


def _read_space(_: Any, value: Any, where: str) -> JointSpace:
    """A joint space, whose limits are told where not all joints are circles."""
    members = value if isinstance(value, dict) else {}
    kind, dim = members.get("kind"), members.get("dim")
    if type(dim) is not int or not 1 <= dim <= MAX_JOINTS or members.get("unit") != "rad":
        _wrong(where, f"a joint space of 1 to {MAX_JOINTS} joints in rad", value)
    if kind == "torus" and "lower" not in members:
        return circles(dim)
    space: JointSpace = _read_fields(JointSpace, members, f"{where}.", {})
    whole = len(space.lower) == len(space.upper) == len(space.periodic) == dim
    ranges = zip(space.lower, space.upper, strict=whole)
    if not whole or not all(-MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD for low, high in ranges):
        _wrong(where, "a joint space with a range for each joint", value)
    if kind != ("mixed" if any(space.periodic) else "box") or all(space.periodic):
        _wrong(where, "the kind of joint space that its joints make", value)
    return space


def _wrong(where: str, expected: str, got: object) -> NoReturn:
    raise ValueError(f"{where}: {got!r:.80} in place of {expected}")


_READERS: dict[Any, _Reader] = {
    Annotated: _read_bounded,
    Union: _read_optional,
    UnionType: _read_optional,
    Literal: _read_choice,
    tuple: _read_tuple,
    np.ndarray: _read_array,
    Mapping: _read_mapping,
    str: _read_text,
    bool: _read_flag,
    int: _read_whole,
    float: _read_number,
    JointSpace: _read_space,
}
"""How a value of each type is read; all others are dataclasses."""


NPY = "application/x-npy"
"""Media type."""
MAX_HEAD_BYTES = 256
"""Before the numbers; the API writes 128."""
MAX_JOINTS = 64
"""Of a robot; wider arrays are none of samples."""

_HEAD = re.compile(
    rb"\x93NUMPY\x01\x00"
    rb"(?P<length>[\x00-\xff]{2})"
    rb"\{'descr': '<f4', 'fortran_order': False, "
    rb"'shape': \((?P<n>[0-9]{1,9}), (?P<d>[0-9]{1,9})\), \} {0,240}\n"
)


def max_body_bytes(n: int) -> int:
    """The largest ``.npy`` that holds ``n`` samples of at most ``MAX_JOINTS`` joints."""
    return MAX_HEAD_BYTES + 4 * MAX_JOINTS * n


def read_rows(body: bytes, what: str) -> NDArray[np.float32]:
    """The array of a ``.npy`` file, (n, d) float32, d from 1 to ``MAX_JOINTS``; it shares the file's memory.

    Args:
        body: the file, whole.
        what: it holds, for the error.

    Raises:
        SamplerAnswerError: it is no such file.
    """
    head = _HEAD.match(body, 0, MAX_HEAD_BYTES)
    if head is None or int.from_bytes(head["length"], "little") != head.end() - 10:
        raise unusable(f"is no .npy file of {what}", "float32 of shape (n, d), by rows", repr(body[:80]))
    rows, columns = int(head["n"]), int(head["d"])
    size = len(body) - head.end()
    # Shape against size: a header may claim any shape.
    if not 1 <= columns <= MAX_JOINTS or 4 * rows * columns != size:
        expected = f"rows of 1 to {MAX_JOINTS} numbers, float32"
        raise unusable("holds another array", expected, f"({rows}, {columns}) in {size} bytes")
    return np.frombuffer(body, dtype="<f4", offset=head.end()).reshape(rows, columns)


def read_samples(body: bytes, n: int, space: JointSpace | None = None) -> NDArray[np.float32]:
    """The samples of a ``.npy`` file, (n, d) float32 rad.

    Args:
        body: the file, whole.
        n: how many there have to be.
        space: whose configurations they are; None for circles alone.

    Raises:
        SamplerAnswerError: it is no such file, or holds other numbers than wrapped angles and values within
            limits.
    """
    samples = read_rows(body, "samples")
    rows, joints = samples.shape
    if rows != n:
        raise unusable("has another number of samples", str(n), str(rows))
    if space is not None and space.dim != joints:
        raise unusable("is for another joint space", f"{space.dim} joints", str(joints))
    # As real numbers: float32(pi) lies above pi. A signalling NaN would warn, or raise where warnings do.
    with np.errstate(invalid="ignore"):
        wrong = int(np.sum(~(space or circles(joints)).holds(samples)))
    if wrong and space is not None:
        ends = f"from {space.lower} to {space.upper}"
        raise unusable("holds values outside the joints' limits", ends[:200], f"{wrong} others")
    if wrong:
        raise unusable("holds values that are no wrapped angles", "[-pi, pi)", f"{wrong} others")
    return samples.astype(np.float32, copy=False)


_PRETRAINED = "pretrained"


def require_requested(model: str | None, robot: str | None, head: ModelHead | SampleBatch) -> None:
    """Refuse the answer of another model than was asked for, or of one of another robot.

    Raises:
        SamplerAnswerError: it is one.
    """
    if not _answers(model, head.model_name, head.model_version):
        raise unusable("comes from another model", str(model), f"{head.model_name}/{head.model_version}")
    if head.robot is not None and robot not in (None, head.robot):
        raise unusable("is of another robot", str(robot), head.robot)


def _answers(requested: str | None, name: str, version: int) -> bool:
    """Whether a model is the one that a reference names.

    A shipped model stands in for a model of its robot without a champion. Which model is the default only
    the server knows, so it may do that for every bare name; an alias or a version has no stand-in.
    """
    if requested is None:
        return True
    requested_name, slash, requested_version = requested.partition("/")
    if slash:
        return (name, str(version)) == (requested_name, requested_version)
    bare, at, _ = requested.partition("@")
    shipped = version == 0 and name.partition("-")[0] == _PRETRAINED
    return name == bare or (not at and shipped)


_MAX_TIMING = 1024
REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)
"""Of the header that answers carry."""


def read_request_id(headers: Mapping[str, str]) -> str | None:
    """The id that the server gave the request; None where a header has none, which is no error."""
    value = headers.get("x-request-id", "")
    return value if REQUEST_ID.fullmatch(value) else None


def read_timing(header: str) -> SourceTiming | None:
    """The entries decode, encode, generate and total of a ``Server-Timing`` header; None where one lacks.

    Proxies add entries of their own or drop the header, so nothing in it is an error.
    """
    durations_s: dict[str, float] = {}
    for entry in header.split(",") if len(header) <= _MAX_TIMING else ():
        name, *parameters = (part.strip() for part in entry.split(";"))
        duration = next((one.removeprefix("dur=") for one in parameters if one.startswith("dur=")), "")
        with suppress(ValueError):
            durations_s[name] = 1e-3 * float(duration)
    try:
        found = SourceTiming(*(durations_s[name] for name in ("decode", "encode", "generate", "total")))
    except KeyError:
        return None
    whole = all(math.isfinite(value) and value >= 0.0 for value in astuple(found))
    return found if whole else None
