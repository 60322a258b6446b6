"""Reads a stranger's answers: headers, .npy bodies and JSON, each checked before use."""

import json
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from cspace_client.errors import printable, unusable
from cspace_client.models import (
    MAX_LIMIT_RAD,
    JointSpace,
    ModelHead,
    PictureWarning,
    SourceTiming,
    Wanted,
    circles,
    is_digest,
)

Choice = TypeVar("Choice", bound=str)
_MAX_DIGITS, _MAX_DEPTH = 21, 64
_SEED = re.compile("[0-9]{1,20}")


def parse_json(data: bytes) -> object:
    """The values of a text in UTF-8 without NaN, infinity, endless numbers, or a key twice in one object.

    Raises:
        ValueError: it is not that, or nested deeper than 64 levels.
    """
    try:
        values = json.loads(
            data.decode("utf-8"),
            parse_constant=_refuse,
            parse_int=_whole,
            parse_float=_finite,
            object_pairs_hook=_unique,
        )
    except RecursionError as error:
        raise ValueError(str(error)) from error
    # What the parser takes may still be too deep for whoever shows it.
    level = [values]
    for _ in range(_MAX_DEPTH + 1):
        held = [
            one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)
        ]
        level = [part for one in held for part in one]
        if not level:
            return values
    raise ValueError(f"it is nested deeper than {_MAX_DEPTH} levels")


class Members:
    """The members of an object in an answer.

    Args:
        values: the object.
        what: the answer is not, where it does not fit, as "a plan".
        path: of the object in the answer, for the error; with a dot at its end.

    Raises:
        SamplerAnswerError: it is no object.
    """

    def __init__(self, values: object, what: str, path: str = "") -> None:
        self._what, self._path = what, path
        if not isinstance(values, Mapping):
            self._wrong("", "an object", values)
        self._values = values

    def one_of(self, name: str, choices: tuple[Choice, ...]) -> Choice:
        """A text that is one of some."""
        value = self._values.get(name)
        found = next((one for one in choices if one == value), None)
        return self._wrong(name, str(choices), value) if found is None else found

    def text(self, name: str, most: int | None = None) -> str:
        """A text; where ``most`` is told, of 1 to so many characters."""
        value = self._values.get(name)
        fits = isinstance(value, str) and (most is None or 1 <= len(value) <= most)
        return str(value) if fits else self._wrong(name, "a text", value)

    def flag(self, name: str) -> bool:
        """Whether it is true."""
        value = self._values.get(name)
        return value if isinstance(value, bool) else self._wrong(name, "true or false", value)

    def whole(self, name: str) -> int:
        """A whole number."""
        value = self._values.get(name)
        return value if type(value) is int else self._wrong(name, "a whole number", value)

    def seed(self, name: str) -> int:
        """A seed, in decimal; a number in answers of earlier servers."""
        value = self._values.get(name)
        if isinstance(value, str) and _SEED.fullmatch(value):
            return int(value)
        return self.count(name)

    def count(self, name: str) -> int:
        """A whole number that is not negative."""
        value = self.whole(name)
        return value if value >= 0 else self._wrong(name, "0 or more", value)

    def number(self, name: str, most: float = math.inf) -> float:
        """A number from 0 to ``most``."""
        return self._number(name, self._values.get(name), 0.0, most)

    def shares(self, name: str) -> list[float]:
        """Numbers from 0 to 1."""
        return [self._number(name, value, 0.0, 1.0) for value in self._list(name, self._values.get(name))]

    def texts(self, name: str) -> list[str]:
        """Texts."""
        values = self._list(name, self._values.get(name))
        return [one if isinstance(one, str) else self._wrong(name, "texts", one) for one in values]

    def row(self, name: str) -> list[float]:
        """Finite numbers."""
        return self._row(name, self._values.get(name))

    def rows(self, name: str) -> list[list[float]]:
        """Lists of finite numbers."""
        return [self._row(name, row) for row in self._list(name, self._values.get(name))]

    def has(self, name: str) -> bool:
        """Whether it is there, and not null."""
        return self._values.get(name) is not None

    def has_required(self, name: str) -> bool:
        """As :meth:`has`, of what has to be told even where it is null."""
        return self.has(name) if name in self._values else self._wrong(name, "a value or null", None)

    def inner(self, name: str) -> "Members":
        """An object."""
        return Members(self._values.get(name), self._what, f"{self._path}{name}.")

    def each(self, name: str) -> list["Members"]:
        """Objects."""
        values = self._list(name, self._values.get(name))
        return [Members(one, self._what, f"{self._path}{name}.") for one in values]

    def plain(self, name: str) -> dict[str, Any]:
        """An object as it is."""
        value = self._values.get(name)
        return dict(value) if isinstance(value, Mapping) else self._wrong(name, "an object", value)

    def _list(self, name: str, value: object) -> list[Any]:
        return value if isinstance(value, list) else self._wrong(name, "a list", value)

    def _row(self, name: str, value: object) -> list[float]:
        return [self._number(name, one, -math.inf, math.inf) for one in self._list(name, value)]

    def _number(self, name: str, value: object, low: float, high: float) -> float:
        if type(value) not in (int, float) or not low <= value <= high:  # type: ignore[operator]
            self._wrong(name, f"a number from {low:g} to {high:g}", value)
        return float(value)  # type: ignore[arg-type]

    def _wrong(self, name: str, expected: str, got: object) -> NoReturn:
        where = f"{self._path}{name}".rstrip(".") or "the document"
        raise unusable(f"is no {self._what}", f"{where}: {expected}", repr(got)[:80])


def _whole(text: str) -> int:
    # As seeds have, in decimal, and a sign.
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"{text[:80]} has too many digits")
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:80]} is not finite")
    return value


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        raise ValueError("a key stands twice in one object")
    return values


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
_MAX_TEXT = 256
_MAX_WARNINGS, _MAX_MESSAGE = 8192, 1000
_ENDS = ("lower", "upper", "periodic")


def read_media_type(headers: Mapping[str, str], expected: str) -> None:
    """Refuse an answer of another media type.

    Raises:
        SamplerAnswerError: it is another.
    """
    media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != expected:
        raise unusable("has another media type", expected, repr(media_type))


def read_model_head(headers: Mapping[str, str], model: str | None, robot: str | None) -> ModelHead:
    """The model's headers of an answer.

    Args:
        headers: of the answer.
        model: that was asked for; None for the default.
        robot: that is planned for; None for any.

    Raises:
        SamplerAnswerError: a header is missing or wrong, or the model another.
    """
    name, version = text(headers, "x-model-name"), count(headers, "x-model-version", 9)
    answered_robot = digest(headers, "x-robot") if "x-robot" in headers else None
    require_requested(model, robot, name, version, answered_robot)
    return ModelHead(
        model_name=name,
        model_version=version,
        digest=digest(headers, "x-model-digest"),
        novelty=share(headers, "x-novelty") if "x-novelty" in headers else None,
        space=read_space(headers["x-joint-space"]) if "x-joint-space" in headers else None,
        robot=answered_robot,
        alias_confirmed=_flag(headers, "x-alias-confirmed") if "x-alias-confirmed" in headers else None,
        warnings=read_warnings(headers.get("x-warnings", "[]")),
    )


def read_warnings(header: str) -> tuple[PictureWarning, ...]:
    """The warnings of an answer's header.

    Raises:
        SamplerAnswerError: it holds none.
    """
    try:
        said = parse_json(header.encode()) if len(header) <= _MAX_WARNINGS else header
    except ValueError:
        said = header
    return warnings_of(Members({"warnings": said}, "list of warnings"))


def warnings_of(answer: Members) -> tuple[PictureWarning, ...]:
    """The member ``warnings`` of an answer.

    Raises:
        SamplerAnswerError: it holds none.
    """
    return tuple(
        PictureWarning(
            printable(one.text("code", _MAX_TEXT)),
            printable(one.text("message"), _MAX_MESSAGE),
            tuple(int(number) for number in one.row("pictures")),
        )
        for one in answer.each("warnings")
    )


def require_requested(
    model: str | None, robot: str | None, name: str, version: int, answered_robot: str | None
) -> None:
    """Refuse the answer of another model than was asked for, or of one of another robot.

    Raises:
        SamplerAnswerError: it is one.
    """
    if not _answers(model, name, version):
        raise unusable("comes from another model", str(model), f"{name}/{version}")
    if answered_robot is not None and robot not in (None, answered_robot):
        raise unusable("is of another robot", str(robot), answered_robot)


def read_space(header: str) -> JointSpace:
    """The joint space that an answer's header says it is of.

    Raises:
        SamplerAnswerError: it says none.
    """
    try:
        said = parse_json(header.encode())
    except ValueError:
        said = None
    return space_of(said, f"header x-joint-space: {header[:80]}")


def space_of(said: object, source: str) -> JointSpace:
    """A joint space as plain values tell it.

    Args:
        said: the values.
        source: where they stand, for the error.

    Raises:
        SamplerAnswerError: they tell none.
    """
    members = dict(said) if isinstance(said, Mapping) else {}
    kind, dim, unit = (members.pop(name, None) for name in ("kind", "dim", "unit"))
    space = _space_of(members, dim) if type(dim) is int and 1 <= dim <= MAX_JOINTS else None
    if space is None or unit != "rad" or kind != _kind(space):
        raise unusable("has a wrong joint space", "a joint space as JSON", source)
    return space


def _kind(space: JointSpace) -> str:
    return "torus" if all(space.periodic) else "mixed" if any(space.periodic) else "box"


def _space_of(said: dict[str, Any], dim: int) -> JointSpace | None:
    if not said:
        return circles(dim)
    columns = [said.get(name) for name in _ENDS]
    if set(said) != set(_ENDS) or not all(isinstance(one, list) and len(one) == dim for one in columns):
        return None
    joints = list(zip(*columns, strict=True))
    if not all(type(wraps) is bool and _is_range(low, high) for low, high, wraps in joints):
        return None
    space = JointSpace(*(tuple(one) for one in zip(*joints, strict=True)))
    # Circles alone are told by their number.
    return None if all(space.periodic) else space


def _is_range(low: object, high: object) -> bool:
    numbers = type(low) in (int, float) and type(high) in (int, float)
    return numbers and -MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD  # type: ignore[operator]


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


def text(headers: Mapping[str, str], name: str) -> str:
    """A header's short printable text."""
    value = headers.get(name, "")
    if not value:
        raise unusable("lacks a header", name, "nothing")
    if len(value) > _MAX_TEXT or not (value.isascii() and value.isprintable()):
        expected = f"at most {_MAX_TEXT} printable ASCII characters"
        raise unusable(f"has a wrong header {name}", expected, repr(value[:40]))
    return value


def count(headers: Mapping[str, str], name: str, digits: int) -> int:
    """A header's whole number of at most so many digits."""
    value = text(headers, name)
    if not (value.isdigit() and len(value) <= digits):
        raise unusable(f"has a wrong header {name}", "a whole number", repr(value[:40]))
    return int(value)


def digest(headers: Mapping[str, str], name: str) -> str:
    """A header's SHA-256."""
    value = text(headers, name)
    if not is_digest(value):
        raise unusable(f"has a wrong header {name}", "a SHA-256 in hexadecimal", repr(value[:80]))
    return value


def share(headers: Mapping[str, str], name: str) -> float:
    """A header's number from 0 to 1."""
    value = text(headers, name)
    try:
        found = float(value)
    except ValueError:
        found = math.nan
    if not 0.0 <= found <= 1.0:
        raise unusable(f"has a wrong header {name}", "a number from 0 to 1", repr(value[:40]))
    return found


def _flag(headers: Mapping[str, str], name: str) -> bool:
    value = text(headers, name)
    if value not in ("true", "false"):
        raise unusable(f"has a wrong header {name}", "true or false", repr(value[:40]))
    return value == "true"


_MAX_TIMING = 1024
REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)
"""Of the header that answers carry."""


@dataclass(frozen=True, slots=True)
class SampleHead:
    """As :class:`cspace_client.models.SampleBatch` has it, without the samples.

    Args:
        model: that answered.
        seed: likewise, and so the rest.
        shortfall: likewise.
        timing: likewise.
        acceptance: likewise.
        request_id: likewise.
    """

    model: ModelHead
    seed: int
    shortfall: int
    timing: SourceTiming | None
    acceptance: float | None = None
    request_id: str | None = None


def read_head(headers: Mapping[str, str], query: Wanted, model: str | None) -> SampleHead:
    """The headers of an answer.

    Args:
        headers: of the answer; names in any case if the mapping does not mind it.
        query: which it has to answer.
        model: that was asked for; None for the default.

    Raises:
        SamplerAnswerError: a header is missing, wrong, or answers another question.
    """
    read_media_type(headers, NPY)
    seed = count(headers, "x-seed", 20)
    if seed != query.seed:
        raise unusable("is for another seed", str(query.seed), str(seed))
    shortfall = count(headers, "x-shortfall", 9)
    if shortfall > query.n:
        raise unusable("lacks more samples than requested", f"at most {query.n}", str(shortfall))
    return SampleHead(
        model=read_model_head(headers, model, query.robot),
        seed=seed,
        shortfall=shortfall,
        timing=read_timing(headers.get("server-timing", "")),
        acceptance=share(headers, "x-acceptance") if "x-acceptance" in headers else None,
        request_id=read_request_id(headers),
    )


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
