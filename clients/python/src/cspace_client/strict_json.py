"""JSON of a stranger, read member by member: what is not as it has to be is an error that names it."""

import json
import math
import re
from collections.abc import Mapping
from typing import Any, NoReturn, TypeVar

from cspace_client.answer_errors import unusable

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

    def row(self, name: str) -> list[float]:
        """Finite numbers."""
        return self._row(name, self._values.get(name))

    def rows(self, name: str) -> list[list[float]]:
        """Lists of finite numbers."""
        return [self._row(name, row) for row in self._list(name, self._values.get(name))]

    def has(self, name: str) -> bool:
        """Whether it is there, and not null."""
        return self._values.get(name) is not None

    def told(self, name: str) -> bool:
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
