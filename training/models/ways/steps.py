"""The steps of the way sampler as ONNX functions: costs that spread, a walk, points along a way.

Written in ONNX itself, for onnxruntime runs a loop as it is: an export from torch would unroll it, into a
graph that is larger and takes minutes to make. What is decorated is the source of a graph and never runs in
Python; types are those of ONNX.
"""
# mypy: ignore-errors

import numpy as np
from onnxscript import FLOAT, INT64, script
from onnxscript import opset18 as op
from onnxscript.values import Opset

# Of a cell that no way leads to, as a gain; a float32 still tells single costs apart beside it.
FAR = -1e6
_LOCAL = Opset("cspace", 1)
_TWO_PI = float(np.float32(2.0 * np.pi))


@script(_LOCAL, default_opset=op)
def _spread(
    weights: FLOAT,
    prices: FLOAT,
    last: INT64,
    watched: INT64,
    beyond_rows: FLOAT,
    beyond_columns: FLOAT,
    sweeps: INT64,
) -> FLOAT:
    """Gains (1, 1, c, c): minus the cost of the way from each cell to the goal's.

    A step costs the weight of the cell it leaves times its length. ``prices`` (3,) are the lengths of a step
    along the first joint, the second, and both. ``beyond_rows`` (c + 2, 1) and ``beyond_columns`` (1, c + 2)
    are added where the grid is laid on beyond its ends: 0, or ``FAR`` where a joint has limits. Sweeps end
    once the gains of the ``watched`` cells (w,) are final, and with them those on their ways: a gain still to
    come would have to come from one that has just risen and is above.
    """
    side = op.Shape(weights, start=2, end=3)
    zero, one = op.Constant(value_ints=[0]), op.Constant(value_ints=[1])
    rows, columns = op.Constant(value_ints=[2]), op.Constant(value_ints=[3])
    blank = op.Expand(
        op.Constant(value_floats=[FAR]), op.Shape(op.Reshape(weights, op.Constant(value_ints=[-1])))
    )
    gains = op.Reshape(op.ScatterElements(blank, last, op.Constant(value_floats=[0.0])), op.Shape(weights))
    first_price, second_price, both_price = op.Split(prices, num_outputs=3)
    # What does not change stays outside of the loop.
    up, across, aslant = weights * first_price, weights * second_price, weights * both_price
    before = side - 1
    # Names of inputs would not be renamed within the loop when the graph is joined to the head's.
    over_rows, over_columns = op.Identity(beyond_rows), op.Identity(beyond_columns)
    seen, flat = op.Identity(watched), op.Constant(value_ints=[-1])
    nothing = op.Constant(value_float=2.0 * FAR)
    for _ in range(sweeps):
        above = op.Slice(gains, before, side, rows)
        below = op.Slice(gains, zero, one, rows)
        vertical = op.MaxPool(op.Concat(above, gains, below, axis=2) + over_rows, kernel_shape=[3, 1])
        left = op.Slice(gains, before, side, columns)
        right = op.Slice(gains, zero, one, columns)
        horizontal = op.MaxPool(op.Concat(left, gains, right, axis=3) + over_columns, kernel_shape=[1, 3])
        left = op.Slice(vertical, before, side, columns)
        right = op.Slice(vertical, zero, one, columns)
        diagonal = op.MaxPool(op.Concat(left, vertical, right, axis=3) + over_columns, kernel_shape=[1, 3])
        better = op.Max(gains, vertical - up, horizontal - across, diagonal - aslant)
        highest = op.ReduceMax(op.Where(better > gains, better, nothing), keepdims=0)
        lowest = op.ReduceMin(op.Gather(op.Reshape(better, flat), seen), keepdims=0)
        gains = op.Identity(better)
        final = highest <= lowest
        if final:
            break
    return gains


@script(_LOCAL, default_opset=op)
def _walk(
    gains: FLOAT, weights: FLOAT, neighbours: INT64, lengths: FLOAT, first: INT64, last: INT64, steps: INT64
) -> INT64:
    """Numbers of the cells from the first one (1,) on, over ``steps`` many; the last one repeats."""
    flat = op.Constant(value_ints=[-1])
    prices = lengths * op.Reshape(weights, flat)
    onward = op.ArgMax(op.Gather(op.Reshape(gains, flat), neighbours) - prices, axis=0, keepdims=1)
    following = op.Reshape(op.GatherElements(neighbours, onward, axis=0), flat)
    # From the last cell one stays there.
    following = op.ScatterElements(following, last, last)
    cells = op.Identity(first)
    # As many again with every turn, by steps that are twice as long.
    for _ in range(steps):
        cells = op.Concat(cells, op.Gather(following, cells), axis=0)
        following = op.Gather(following, following)
        enough = op.Size(cells) > steps
        if enough:
            break
    return cells


@script(_LOCAL, default_opset=op)
def _rows_in_sweeps(place: FLOAT, sweep: INT64) -> tuple[INT64, INT64, INT64]:
    """Number of each row (m, 1) within its sweep, number of its sweep, and rows of a sweep, at most all."""
    rows = op.Shape(place, start=0, end=1)
    count = op.Min(rows, sweep)
    number = op.CumSum(op.Expand(op.Constant(value_ints=[1]), rows), op.Constant(value_int=0)) - 1
    turn = number / count
    last = op.Constant(value_ints=[1])
    return op.Unsqueeze(number - turn * count, last), op.Unsqueeze(turn, last), count


@script(_LOCAL, default_opset=op)
def _legs(corners: FLOAT, wraps: FLOAT) -> FLOAT:
    """From each corner (k, d) to the next by the shorter way round, (k - 1, d)."""
    zero, one, end = (
        op.Constant(value_ints=[0]),
        op.Constant(value_ints=[1]),
        op.Constant(value_ints=[-1]),
    )
    plain = op.Slice(corners, one, op.Shape(corners, start=0, end=1), zero) - op.Slice(
        corners, zero, end, zero
    )
    return plain - wraps * _TWO_PI * op.Round(plain / _TWO_PI)


@script(_LOCAL, default_opset=op)
def _along(corners: FLOAT, legs: FLOAT, wanted: FLOAT) -> FLOAT:
    """Points at so many rad (m, 1) along a path of corners (k, d), (m, d)."""
    one = op.Constant(value_ints=[1])
    lengths = op.Sqrt(op.ReduceSum(legs * legs, one, keepdims=0))
    reached = op.CumSum(lengths, op.Constant(value_int=0))
    passed = op.Cast(op.LessOrEqual(op.Unsqueeze(reached, op.Constant(value_ints=[0])), wanted), to=7)
    leg = op.Min(op.ReduceSum(passed, one, keepdims=0), op.Shape(lengths) - 1)
    length = op.Gather(lengths, leg)
    gone = op.Squeeze(wanted, one) - op.Gather(reached, leg) + length
    share = op.Min(op.Max(gone / op.Max(length, op.Constant(value_float=1e-9)), 0.0), 1.0)
    return op.Gather(corners, leg) + op.Unsqueeze(share, one) * op.Gather(legs, leg)


@script(_LOCAL, default_opset=op)
def _cell(ends: FLOAT, low: FLOAT, size: FLOAT, count: FLOAT, strides: INT64) -> INT64:
    """Number of the cell (1,) that holds the first of the configurations (m, d)."""
    zero, one = op.Constant(value_ints=[0]), op.Constant(value_ints=[1])
    place = op.Floor((op.Slice(ends, zero, one, zero) - low) / size)
    inside = op.Max(op.Min(place, count - 1.0), 0.0)
    return op.ReduceSum(op.Cast(inside, to=7) * strides, one, keepdims=0)


@script(default_opset=op)
def way_samples(
    confidence: FLOAT["n"],  # noqa: F821
    place: FLOAT["m", 1],  # noqa: F821
    jitter: FLOAT["m", 2],  # noqa: F821
    start: FLOAT["m", 2],  # noqa: F821
    goal: FLOAT["m", 2],  # noqa: F821
    grid: FLOAT,
    grid_shape: INT64,
    neighbours: INT64,
    step_lengths: FLOAT,
    prices: FLOAT,
    wraps: FLOAT,
    beyond_rows: FLOAT,
    beyond_columns: FLOAT,
    low: FLOAT,
    size: FLOAT,
    count: FLOAT,
    strides: INT64,
    penalty: FLOAT,
    levels: FLOAT,
    sweeps: INT64,
    gap: FLOAT,
    tube: FLOAT,
    widening: FLOAT,
    widest: FLOAT,
) -> FLOAT["m", 1, 2]:  # noqa: F821
    """All of it, with what is fixed as inputs that the builder turns into initialisers."""
    zero, one = op.Constant(value_ints=[0]), op.Constant(value_ints=[1])
    read = op.Round(confidence * levels) / levels
    weights = op.Reshape((1.0 - read) * penalty + 1.0, grid_shape)
    first = _cell(start, low, size, count, strides)
    last = _cell(goal, low, size, count, strides)
    gains = _spread(weights, prices, last, first, beyond_rows, beyond_columns, sweeps)
    cells = _walk(gains, weights, neighbours, step_lengths, first, last, sweeps)
    # The ends themselves instead of the centres of their cells.
    inner = op.Gather(grid, op.Slice(cells, one, op.Shape(cells), zero))
    corners = op.Concat(op.Slice(start, zero, one, zero), inner, op.Slice(goal, zero, one, zero), axis=0)
    legs = _legs(corners, wraps)
    whole = op.ReduceSum(op.Sqrt(op.ReduceSum(legs * legs, one, keepdims=0)), keepdims=0)
    # As many samples a sweep as leave about the gap between two; one where there is to be no order.
    sweep = op.Cast(op.Min(op.Ceil(whole / op.Max(gap, 1e-6)), 4096.0), to=7)
    sweep = op.Max(op.Where(gap > 0.0, sweep, op.Constant(value_ints=[1])), 1)
    number, turn, rows = _rows_in_sweeps(place, sweep)
    wanted = (op.Cast(number, to=1) + place) / op.Cast(rows, to=1) * whole
    width = op.Where(gap > 0.0, op.Min(tube + widening * op.Cast(turn, to=1), widest), widest)
    # The output is named after the variable.
    samples = op.Unsqueeze(_along(corners, legs, wanted) + jitter * width, one)
    return samples  # noqa: RET504


@script(default_opset=op)
def way_maps(
    confidence: FLOAT["n"],  # noqa: F821
    start: FLOAT["m", 2],  # noqa: F821
    goal: FLOAT["m", 2],  # noqa: F821
    grid_shape: INT64,
    prices: FLOAT,
    beyond_rows: FLOAT,
    beyond_columns: FLOAT,
    low: FLOAT,
    size: FLOAT,
    count: FLOAT,
    strides: INT64,
    penalty: FLOAT,
    sweeps: INT64,
    farthest: FLOAT,
) -> FLOAT["k"]:  # noqa: F821
    """Confidence, detour and progress of all cells, one after the other."""
    flat = op.Constant(value_ints=[-1])
    weights = op.Reshape((1.0 - confidence) * penalty + 1.0, grid_shape)
    first = _cell(start, low, size, count, strides)
    last = _cell(goal, low, size, count, strides)
    every = op.Range(0, op.Size(confidence), 1)
    behind = op.Reshape(_spread(weights, prices, first, every, beyond_rows, beyond_columns, sweeps), flat)
    ahead = op.Reshape(_spread(weights, prices, last, every, beyond_rows, beyond_columns, sweeps), flat)
    whole = behind + ahead
    detour = op.Min(op.ReduceMax(whole, keepdims=0) - whole, farthest)
    near = op.Cast(detour < farthest, to=1)
    progress = near * behind / op.Min(whole, -0.000001)
    # The output is named after the variable.
    maps = op.Concat(confidence, detour, progress, axis=0)
    return maps  # noqa: RET504
