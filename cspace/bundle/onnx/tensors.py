"""The tensors of a graph: whole, of numbers, inside the file, and as large as they say."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.onnx.fields import TENSOR
from cspace.bundle.onnx.wire import Budget, Message

# Of one tensor; 256 MiB as float32.
MAX_ELEMENTS = 2**26
MAX_RANK = 8
# As many values of an integer tensor are looked at: a shape, or the turns of a loop.
_READ = 16
_INT32, _INT64, _DOUBLE, _UINT64 = "int32_data", "int64_data", "double_data", "uint64_data"
# The number of a type to the bytes of an element and the field that holds it where raw_data does not.
_TYPES = {
    1: (4, "float_data"), 2: (1, _INT32), 3: (1, _INT32), 4: (2, _INT32), 5: (2, _INT32), 6: (4, _INT32),
    7: (8, _INT64), 9: (1, _INT32), 10: (2, _INT32), 11: (8, _DOUBLE), 12: (4, _UINT64), 13: (8, _UINT64),
}  # fmt: skip
_DATA = ("float_data", _INT32, _INT64, _DOUBLE, _UINT64)
INT64 = 7


@dataclass(frozen=True, slots=True)
class Tensor:
    """A tensor of a graph.

    Args:
        name: empty for one in an attribute.
        shape: its sizes.
        values: of a small int64 tensor, None for others.
        kind: its type by ONNX's number.
    """

    name: str
    shape: tuple[int, ...]
    values: tuple[int, ...] | None
    kind: int


def read_tensor(data: memoryview, budget: Budget) -> Tensor:
    """Check a tensor.

    Raises:
        BundleIntegrityError: it lies outside of the file, or is not what it says.
    """
    message = Message("a tensor", TENSOR, data, budget)
    if "external_data" in message or message.number("data_location"):
        raise budget.refuse("a tensor that keeps its weights outside the bundle", "a graph that is whole")
    kind = message.number("data_type")
    if kind not in _TYPES:
        raise budget.refuse(f"a tensor of type {kind}", f"types {sorted(_TYPES)}")
    shape = checked_shape(message.numbers("dims"), budget)
    count = math.prod(shape)
    size, typed = _TYPES[kind]
    present = [name for name in (*_DATA, "raw_data") if name in message]
    raw = present == ["raw_data"]
    found = len(message.parts("raw_data")[0]) / size if raw else _count(message, typed, budget)
    if not set(present) <= {"raw_data", typed} or len(present) > 1 or found != count:
        raise budget.refuse(f"a tensor of shape {shape} with other data", "as many values as its shape says")
    values = _integers(message, raw=raw) if kind == INT64 and count <= _READ else None
    return Tensor(message.text("name"), shape, values, kind)


def checked_shape(sizes: list[int], budget: Budget) -> tuple[int, ...]:
    """Sizes that a tensor can have.

    Raises:
        BundleIntegrityError: negative, too many, or too large together.
    """
    fits = len(sizes) <= MAX_RANK and all(0 <= size <= MAX_ELEMENTS for size in sizes)
    if not fits or math.prod(sizes) > MAX_ELEMENTS:
        expected = f"at most {MAX_RANK} sizes, together at most {MAX_ELEMENTS} elements"
        raise budget.refuse(f"a tensor of shape {str(sizes)[:100]}", expected)
    return tuple(sizes)


def _integers(message: Message, *, raw: bool) -> tuple[int, ...]:
    if not raw:
        return tuple(message.numbers(_INT64))
    values: NDArray[np.int64] = np.frombuffer(message.parts("raw_data")[0], dtype="<i8")
    return tuple(values.tolist())


def _count(message: Message, name: str, budget: Budget) -> int:
    """Values in a field of numbers; without making a Python object of each."""
    fixed = {"float_data": 4, _DOUBLE: 8}.get(name)
    count = 0
    for value in message.occurrences(name):
        if isinstance(value, int):
            count += 1
        elif fixed is not None:
            count += _whole(len(value), fixed, budget)
        else:
            count += _ends(value, budget)
    return count


def _whole(size: int, of: int, budget: Budget) -> int:
    if size % of:
        raise budget.refuse("a torn list of numbers", "whole numbers of bytes")
    return size // of


def _ends(data: memoryview, budget: Budget) -> int:
    """Varints in a packed field, each of at most ten bytes."""
    ends = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) < 0x80)
    longest = np.diff(ends, prepend=-1).max(initial=0)
    if len(data) and (not len(ends) or ends[-1] != len(data) - 1 or longest > 10):
        raise budget.refuse("a torn list of numbers", "numbers of 64 bits")
    return len(ends)
