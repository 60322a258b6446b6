"""Strict reading of a bundle's JSON: no unknown or missing key, no silent conversion, no NaN."""

import json
import math
from collections.abc import Mapping
from typing import Any

from cspace.errors import BundleIntegrityError

MAX_BYTES = 2**20
MAX_DEPTH = 32
# As seeds are unsigned.
_LARGEST = 2**64 - 1
_SHOWN = 200


def parse_json(data: bytes) -> object:
    """Strict JSON: UTF-8, no NaN or infinity, no key twice in one object, no more than people write.

    Raises:
        BundleIntegrityError: the bytes are not that, or too many, too deep or of too large numbers.
    """
    try:
        values: object = json.loads(
            _bounded(data).decode("utf-8"),
            parse_constant=_refuse_constant,
            parse_int=_integer,
            parse_float=_number,
            object_pairs_hook=_unique_object,
        )
        _check_depth(values)
    except (ValueError, RecursionError) as error:
        raise BundleIntegrityError(
            "the bundle's description is not JSON",
            expected=f"UTF-8 JSON of at most {MAX_BYTES} bytes, {MAX_DEPTH} deep, with finite numbers of 64 "
            "bits and unique keys",
            got=str(error)[:_SHOWN],
        ) from error
    return values


class StrictObject:
    """A JSON object with exactly the given keys, read by type.

    Args:
        where: its name in messages.
        values: what came.
        keys: the keys that it must have.

    Raises:
        BundleIntegrityError: here and in every method, when something does not fit.
    """

    def __init__(self, where: str, values: object, keys: set[str]) -> None:
        self._where = where
        if not isinstance(values, Mapping):
            raise self._wrong("an object", values)
        if set(values) != keys:
            missing, unknown = sorted(keys - set(values)), sorted(map(str, set(values) - keys))
            raise BundleIntegrityError(
                f"{where} has other keys",
                expected=f"exactly {sorted(keys)}",
                got=f"missing {missing}, unknown {unknown}"[:_SHOWN],
            )
        self._values: Mapping[str, Any] = values

    def get(self, key: str) -> Any:
        """The value as it is."""
        return self._values[key]

    def text(self, key: str) -> str:
        """A string."""
        value = self._values[key]
        if not isinstance(value, str):
            raise self._wrong("a text", value, key)
        return value

    def text_or_none(self, key: str) -> str | None:
        """A string or null."""
        return None if self._values[key] is None else self.text(key)

    def truth_or_none(self, key: str) -> bool | None:
        """True, false or null."""
        value = self._values[key]
        if value is None or isinstance(value, bool):
            return value
        raise self._wrong("true, false or null", value, key)

    def integer(self, key: str) -> int:
        """A whole number."""
        return self._integer(self._values[key], key)

    def integers(self, key: str) -> list[int]:
        """A list of whole numbers."""
        return [self._integer(value, key) for value in self.items(key)]

    def number(self, key: str) -> float:
        """A finite number."""
        return self._number(self._values[key], key)

    def number_or_none(self, key: str) -> float | None:
        """A finite number or null."""
        return None if self._values[key] is None else self.number(key)

    def numbers(self, key: str) -> list[float]:
        """A list of finite numbers."""
        return [self._number(value, key) for value in self.items(key)]

    def items(self, key: str) -> list[Any]:
        """A list."""
        value = self._values[key]
        if not isinstance(value, list):
            raise self._wrong("a list", value, key)
        return value

    def mapping(self, key: str) -> Mapping[str, Any]:
        """An object."""
        value = self._values[key]
        if not isinstance(value, Mapping):
            raise self._wrong("an object", value, key)
        return value

    def must_be(self, key: str, expected: object) -> None:
        """A value that follows from the others."""
        if self._values[key] != expected:
            raise self._wrong(json.dumps(expected), self._values[key], key)

    def _integer(self, value: object, key: str) -> int:
        if not isinstance(value, int) or isinstance(value, bool):
            raise self._wrong("a whole number", value, key)
        return value

    def _number(self, value: object, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._wrong("a finite number", value, key)
        return float(value)

    def _wrong(self, expected: str, got: object, key: str | None = None) -> BundleIntegrityError:
        place = self._where if key is None else f"{self._where}: {key}"
        return BundleIntegrityError(f"{place} does not fit", expected=expected, got=repr(got)[:_SHOWN])


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _bounded(data: bytes) -> bytes:
    if len(data) > MAX_BYTES:
        raise ValueError(f"{len(data)} bytes")
    return data


def _integer(text: str) -> int:
    value = int(text) if len(text) <= len(str(-_LARGEST)) else _LARGEST + 1
    if abs(value) > _LARGEST:
        raise ValueError(f"{text[:_SHOWN]} has more than 64 bits")
    return value


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:_SHOWN]} is not finite")
    return value


def _check_depth(values: object) -> None:
    """Bounded nesting, so that nothing later recurses too deep; texts that can be written again."""
    layer: list[object] = [values]
    for _ in range(MAX_DEPTH + 1):
        if not layer:
            return
        below: list[object] = []
        for value in layer:
            if isinstance(value, dict):
                below += [*value, *value.values()]
            elif isinstance(value, list):
                below += value
            elif isinstance(value, str):
                value.encode()
        layer = below
    raise ValueError(f"nested more than {MAX_DEPTH} deep")


def _unique_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        raise ValueError("a key stands twice in one object")
    return values
