"""The protobuf wire format, read strictly and without copying, before a library sees the bytes.

Stricter than protobuf itself, which merges repeated occurrences and takes the last one of a number: a field
that is to stand once stands once, so that there is one reading of the bytes and no other.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from cspace.errors import BundleIntegrityError

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
MAX_FIELDS = 500_000
MAX_NOTES_BYTES = 4 * 2**20
MAX_TEXT_BYTES = 1024
_LONGEST_VARINT = 10


class Form(Enum):
    """What a field holds; the value is the wire type of one occurrence."""

    NUMBER = (VARINT, "number")
    FLOAT = (FIXED32, "float")
    DOUBLE = (FIXED64, "double")
    TEXT = (LENGTH, "text")
    BYTES = (LENGTH, "bytes")
    MESSAGE = (LENGTH, "message")
    NOTE = (LENGTH, "note")


@dataclass(frozen=True, slots=True)
class Rule:
    """One field of a message.

    Args:
        name: as ONNX names it.
        form: what it holds.
        many: whether it may stand more than once; numbers may be packed then.
    """

    name: str
    form: Form
    many: bool = False


@dataclass(slots=True)
class Budget:
    """What may still be read of one file.

    Args:
        name: the file's, for messages.
        fields: occurrences of fields.
        notes_bytes: of texts that only people read.
    """

    name: str
    fields: int = MAX_FIELDS
    notes_bytes: int = MAX_NOTES_BYTES

    def refuse(self, what: str, expected: str) -> BundleIntegrityError:
        """The refusal of this file."""
        return BundleIntegrityError(
            f"{self.name} cannot be opened",
            expected=expected,
            got=what,
            remedy="export the graph again with the project's exporters",
        )


Kind = dict[int, Rule]


class Message:
    """One message: its fields by their names.

    Args:
        what: the message's name, for messages.
        kind: the fields that it may have; any other is refused.
        data: its bytes; they are looked at in place.
        budget: of the file.

    Raises:
        BundleIntegrityError: not such a message, or more of it than the budget allows.
    """

    __slots__ = ("_budget", "_values", "what")

    def __init__(self, what: str, kind: Kind, data: memoryview, budget: Budget) -> None:
        self.what, self._budget = what, budget
        self._values: dict[str, list[int | memoryview]] = {}
        for number, wire, value in _fields(data, budget):
            rule = kind.get(number)
            if rule is None:
                raise budget.refuse(f"field {number} of {what}", "only what the project's graphs consist of")
            one, _ = rule.form.value
            packed = rule.many and wire == LENGTH and one != LENGTH
            if wire != one and not packed:
                raise budget.refuse(f"{what}.{rule.name} of wire type {wire}", f"wire type {one}")
            if rule.form is Form.NOTE:
                self._note(value)
                continue
            found = self._values.setdefault(rule.name, [])
            if found and not rule.many:
                raise budget.refuse(f"{what}.{rule.name} more than once", "each field once")
            found.append(value)

    def _note(self, value: int | memoryview) -> None:
        self._budget.notes_bytes -= len(value) if isinstance(value, memoryview) else 0
        if self._budget.notes_bytes < 0:
            raise self._budget.refuse("more", f"notes and metadata of at most {MAX_NOTES_BYTES} bytes")

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def number(self, name: str, default: int = 0) -> int:
        """A number, signed."""
        (value,) = self._values.get(name, [default])
        return _signed(value) if isinstance(value, int) else default

    def occurrences(self, name: str) -> list[int | memoryview]:
        """Every occurrence as it is: numbers unsigned, everything else as bytes."""
        return self._values.get(name, [])

    def parts(self, name: str) -> list[memoryview]:
        """The bytes of every occurrence of a field that holds bytes, texts or messages."""
        return [value for value in self._values.get(name, []) if isinstance(value, memoryview)]

    def texts(self, name: str) -> list[str]:
        """Every occurrence as text."""
        return [self._text(name, value) for value in self.parts(name)]

    def text(self, name: str) -> str:
        """The text, empty where the field is absent."""
        return next(iter(self.texts(name)), "")

    def numbers(self, name: str) -> list[int]:
        """Signed numbers, packed or not."""
        found: list[int] = []
        for value in self._values.get(name, []):
            if isinstance(value, int):
                found.append(_signed(value))
            else:
                found.extend(_signed(number) for number in _packed(value, self._budget))
        return found

    def _text(self, name: str, value: memoryview) -> str:
        if len(value) > MAX_TEXT_BYTES:
            raise self._budget.refuse(f"{self.what}.{name} of {len(value)} bytes", f"{MAX_TEXT_BYTES}")
        try:
            return str(value, "utf-8")
        except UnicodeDecodeError as error:
            raise self._budget.refuse(f"{self.what}.{name} as other bytes", "UTF-8") from error


def _fields(data: memoryview, budget: Budget) -> Iterator[tuple[int, int, int | memoryview]]:
    at, end = 0, len(data)
    while at < end:
        budget.fields -= 1
        if budget.fields < 0:
            raise budget.refuse("more", f"at most {MAX_FIELDS} fields")
        key, at = _varint(data, at, budget)
        number, wire = key >> 3, key & 7
        value: int | memoryview
        if wire == VARINT:
            value, at = _varint(data, at, budget)
        elif wire in (LENGTH, FIXED32, FIXED64):
            size = 4 if wire == FIXED32 else 8
            if wire == LENGTH:
                size, at = _varint(data, at, budget)
            if size > end - at:
                raise budget.refuse("a field that ends behind its message", "whole fields")
            value = data[at : at + size]
            at += size
        else:
            raise budget.refuse(f"wire type {wire}", "wire types 0, 1, 2 and 5")
        yield number, wire, value


def _varint(data: memoryview, at: int, budget: Budget) -> tuple[int, int]:
    value = shift = 0
    for byte in data[at : at + _LONGEST_VARINT]:
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            if value >= 2**64 or (shift and not byte):
                break
            return value, at
        shift += 7
    raise budget.refuse("a number that does not end, or longer than it has to be", "numbers of 64 bits")


def _packed(data: memoryview, budget: Budget) -> Iterator[int]:
    at = 0
    while at < len(data):
        budget.fields -= 1
        if budget.fields < 0:
            raise budget.refuse("more", f"at most {MAX_FIELDS} fields")
        value, at = _varint(data, at, budget)
        yield value


def _signed(value: int) -> int:
    return value - 2**64 if value >= 2**63 else value
