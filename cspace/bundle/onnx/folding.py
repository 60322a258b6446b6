"""How much a graph computes from constants alone, told from its bytes.

onnxruntime computes that once while it opens the graph, where nothing can end it. Sizes are bounded here from
above, without computing anything; where they are many or hard to tell, a graph is tried before
(see :mod:`cspace.bundle.running.sessions`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

from cspace.bundle.onnx.tensors import MAX_ELEMENTS, MAX_RANK

# Elements of all of a graph's; some milliseconds of work.
MAX_FOLDED = 2**22


class Folding(Enum):
    """Whether a graph may compute from constants while it is opened."""

    QUICK = auto()
    """It is little."""
    TO_BE_TRIED = auto()
    """It may be much; a run computes the same, and a run can be ended."""
    UNSAFE = auto()
    """It may be much, and within a loop, which a run may never enter."""


@dataclass(frozen=True, slots=True)
class Value:
    """What is known of a value of a graph.

    Args:
        size: of a constant, at most so many elements; None where that is hard to tell.
        constant: whether it follows from constants alone.
        shape: of a constant, where it is known.
        values: of a small int64 constant, where they are known.
        kind: its type by ONNX's number, None for an unknown one.
        natural: whether it is surely never negative.
        apart: whether it is surely that, or below -2^62: never -1, nor a few steps from it.
    """

    size: int | None = None
    constant: bool = False
    shape: tuple[int, ...] | None = None
    values: tuple[int, ...] | None = None
    kind: int | None = None
    natural: bool = False
    apart: bool = False


UNKNOWN = Value()
SMALL = Value(MAX_RANK, constant=True)
# The result is no larger than the first input.
_UNARY = """
Abs Acos Acosh ArgMax ArgMin Asin Asinh Atan Atanh Cast CastLike Ceil Celu Clip Compress Cos Cosh CumSum
DepthToSpace Dropout Elu Erf Exp Flatten Floor Gelu HardSigmoid HardSwish Hardmax Identity IsInf IsNaN
LeakyRelu Log LogSoftmax Mish Neg Not Reciprocal ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax
ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu Reshape Round ScatterElements ScatterND
Selu Sigmoid Sign Sin Sinh Slice Softmax Softplus Softsign SpaceToDepth Split Sqrt Squeeze Swish Tan Tanh
ThresholdedRelu Transpose Trilu Unsqueeze
"""
_ARITHMETIC = """
Add And Div Equal Greater GreaterOrEqual Less LessOrEqual Max Mean Min Mod Mul Or PRelu Pow Sub Sum Where
Xor
"""
_NO_LARGER = frozenset(_UNARY.split())
_TOGETHER = frozenset(_ARITHMETIC.split())
_SAME_VALUES = frozenset({"Identity", "Reshape", "Squeeze", "Unsqueeze"})
_SAME_SHAPE = frozenset({"Abs", "Cast", "CastLike", "Identity", "LeakyRelu", "Neg", "Not", "Sigmoid", "Sqrt"})


def folded(operator: str, inputs: Sequence[Value]) -> Value:
    """What a node makes of constants."""
    sizes = [value.size for value in inputs if value.size is not None]
    if len(sizes) < len(inputs) or not sizes:
        return Value(constant=True)
    first = inputs[0]
    if operator in _NO_LARGER:
        values = first.values if operator in _SAME_VALUES else None
        shape = first.shape if operator in _SAME_SHAPE else None
        return Value(sizes[0], constant=True, shape=shape, values=values)
    if operator in _TOGETHER:
        return _broadcast(inputs, sizes)
    if operator == "Concat":
        return Value(sum(sizes), constant=True)
    if operator in ("Gather", "MatMul") and len(sizes) == 2:
        return Value(sizes[0] * sizes[1], constant=True)
    asked = elements_asked_for(operator, inputs)
    return Value(asked, constant=True)


def elements_asked_for(operator: str, inputs: Sequence[Value]) -> int | None:
    """Elements of what is made by a shape that is written in the graph, None where none is."""
    place = {"ConstantOfShape": 0, "Expand": 1, "Tile": 1}.get(operator)
    if operator == "Range" and len(inputs) == 3:
        ends = [value.values for value in inputs]
        known = [end[0] for end in ends if end is not None and len(end) == 1]
        return None if len(known) < 3 or not known[2] else max(0, -((known[0] - known[1]) // known[2]))
    if place is None or len(inputs) <= place:
        return None
    values, base = inputs[place].values, inputs[0].size if place else 1
    if values is None:
        return None
    asked = math.prod(max(abs(value), 1) for value in values)
    return asked if operator == "ConstantOfShape" or base is None else asked * base


def is_absurd(operator: str, inputs: Sequence[Value]) -> bool:
    """Whether a node makes more than a tensor may have, as far as the graph tells."""
    asked = elements_asked_for(operator, inputs)
    return asked is not None and asked > MAX_ELEMENTS


def _broadcast(inputs: Sequence[Value], sizes: Sequence[int]) -> Value:
    shapes = [value.shape for value in inputs if value.shape is not None]
    if len(shapes) < len(inputs):
        return Value(math.prod(max(size, 1) for size in sizes), constant=True)
    rank = max(len(shape) for shape in shapes)
    padded = [(1,) * (rank - len(shape)) + shape for shape in shapes]
    shape = tuple(max(column) for column in zip(*padded, strict=True))
    return Value(math.prod(shape), constant=True, shape=shape)
