"""The attributes of a node: each once, of one kind, and no size that an operator divides by is 0."""

import math
from dataclasses import dataclass, field

from cspace.bundle.onnx.fields import ATTRIBUTE, ATTRIBUTE_VALUES
from cspace.bundle.onnx.folding import Value
from cspace.bundle.onnx.integers import FLOAT, INT64
from cspace.bundle.onnx.tensors import Tensor, read_tensor
from cspace.bundle.onnx.wire import Budget, Message

_SIZES = frozenset(
    {"blocksize", "dilations", "group", "kernel_shape", "num_groups", "num_outputs", "size", "strides"}
)
_LARGEST_SIZE = 2**16


@dataclass(slots=True)
class Attributes:
    """What matters of a node's attributes.

    Args:
        numbers: name to value, of those that are one whole number.
        constant: the tensor or numbers of a Constant, None without.
        body: the bytes of the graph within, None without.
    """

    numbers: dict[str, int] = field(default_factory=dict)
    constant: Value | None = None
    body: memoryview | None = None


def read_attributes(node: Message, budget: Budget) -> Attributes:
    """Check a node's attributes.

    Raises:
        BundleIntegrityError: one is not clear, or of a size that cannot be.
    """
    found = Attributes()
    names: set[str] = set()
    for part in node.parts("attribute"):
        entry = Message("an attribute", ATTRIBUTE, part, budget)
        name = entry.text("name")
        holds = ATTRIBUTE_VALUES.get(entry.number("type"))
        others = [other for other in ATTRIBUTE_VALUES.values() if other in entry and other != holds]
        if holds is None or others or name in names:
            raise budget.refuse(f"an attribute {name[:100]!r} that is not clear", "one value of one kind")
        names.add(name)
        _take(found, name, holds, entry, budget)
    return found


def _take(found: Attributes, name: str, holds: str, entry: Message, budget: Budget) -> None:
    if holds in ("i", "ints"):
        numbers = entry.numbers("ints") if holds == "ints" else [entry.number("i")]
        if name in _SIZES and not all(1 <= number <= _LARGEST_SIZE for number in numbers):
            raise budget.refuse(f"{name} = {str(numbers)[:100]}", f"{name} of 1 to {_LARGEST_SIZE}")
        found.constant = integers(numbers, (len(numbers),) if holds == "ints" else ())
        if holds == "i":
            found.numbers[name] = numbers[0]
    elif holds in ("f", "floats"):
        count = 1 if holds == "f" else sum(max(len(part) // 4, 1) for part in entry.parts("floats"))
        found.constant = Value(count, constant=True, kind=FLOAT)
    elif holds == "t":
        for tensor in entry.parts("t"):
            found.constant = constant(read_tensor(tensor, budget))
    elif holds == "g":
        for body in entry.parts("g"):
            found.body = body


def integers(numbers: list[int], shape: tuple[int, ...]) -> Value:
    """A constant of int64."""
    return constant(Tensor("", shape, tuple(numbers), INT64))


def constant(tensor: Tensor) -> Value:
    """A tensor that stands in the graph."""
    natural = tensor.values is not None and all(value >= 0 for value in tensor.values)
    return Value(
        math.prod(tensor.shape),
        constant=True,
        shape=tensor.shape,
        values=tensor.values,
        kind=tensor.kind,
        natural=natural,
        apart=natural,
    )
