"""Which values of a graph are integers, and which of those are never negative: so that nothing divides by -1.

The smallest integer divided by -1 is none, and onnxruntime's Div and Mod end the whole process over it. So
what divides integers has to be a constant without -1, or a value that can not be negative. What is unknown
here counts as an integer that may be.
"""

from collections.abc import Mapping, Sequence

from cspace.bundle.onnx.folding import Value

FLOAT, INT64, BOOL = 1, 7, 9
_FRACTIONS = frozenset({FLOAT, 10, 11})
_UNSIGNED = frozenset({2, 4, 12, 13})
_COUNTS = frozenset({"ArgMax", "ArgMin", "NonZero", "Shape", "Size"})
_TRUTHS = frozenset(
    {"And", "Equal", "Greater", "GreaterOrEqual", "IsInf", "IsNaN", "Less", "LessOrEqual", "Not", "Or", "Xor"}
)
# The input whose type the result has, where it is not the first.
_LIKE = {"Where": 1, "CastLike": 1, "OneHot": 2}
_MOVED = frozenset(
    {"Expand", "Gather", "Identity", "Reshape", "Slice", "Split", "Squeeze", "Tile", "Transpose", "Unsqueeze"}
)
_KEPT = _MOVED | {"ReduceMax", "ReduceMin"}
_SMALL = 2**31


def kind_of(operator: str, inputs: Sequence[Value], numbers: Mapping[str, int]) -> int | None:
    """The type of a node's first output by ONNX's numbers, None for an unknown one.

    Args:
        operator: of the standard set.
        inputs: what is known of its inputs.
        numbers: its attributes of one whole number each.
    """
    if operator == "Cast":
        return numbers.get("to")
    if operator == "EyeLike":
        return numbers.get("dtype")
    if operator in _COUNTS:
        return INT64
    if operator in _TRUTHS:
        return BOOL
    place = _LIKE.get(operator, 0)
    return inputs[place].kind if place < len(inputs) else None


def is_natural(operator: str, inputs: Sequence[Value], kind: int | None) -> bool:
    """Whether a node's output is surely never negative."""
    if operator in _COUNTS:
        return True
    if operator == "Max":
        return any(value.natural for value in inputs)
    if operator == "Range":
        return len(inputs) == 3 and inputs[0].natural and inputs[2].natural
    if operator in ("Cast", "CastLike") and not _keeps(inputs, kind):
        return False
    of = {"Min": inputs, "Concat": inputs, "Where": inputs[1:]}.get(operator, inputs[:1])
    known = operator in _MOVED or operator in ("Min", "Concat", "Where", "Cast", "CastLike")
    return known and bool(of) and all(value.natural for value in of)


def is_apart(operator: str, inputs: Sequence[Value], kind: int | None) -> bool:
    """Whether a node's output is surely not negative, or far below: the highest of nothing, a sum too large.

    A small number more leaves it so, as often as a run can add one.
    """
    if not inputs:
        return False
    if operator in ("Max", "Min"):
        return all(value.apart for value in inputs)
    if operator == "Clip":
        return inputs[0].apart and all(value.natural for value in inputs[1:])
    if operator == "Add":
        known = [value.values for value in inputs if value.natural and value.values is not None]
        small = [max(values, default=0) <= _SMALL for values in known]
        return all(value.apart for value in inputs) and any(small)
    if operator in ("Cast", "CastLike"):
        return _keeps(inputs, kind) and inputs[0].apart
    return operator in _KEPT and inputs[0].apart


def _keeps(inputs: Sequence[Value], kind: int | None) -> bool:
    return kind is not None and bool(inputs) and inputs[0].kind == kind


def may_divide_by_minus_one(operator: str, inputs: Sequence[Value]) -> bool:
    """Whether a node may divide integers by -1."""
    if operator not in ("Div", "Mod") or len(inputs) != 2:
        return False
    number, divisor = inputs
    if number.kind in _FRACTIONS | _UNSIGNED or divisor.natural or divisor.apart:
        return False
    return divisor.values is None or -1 in divisor.values
