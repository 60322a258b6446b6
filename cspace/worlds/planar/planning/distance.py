"""Euclidean distance transform on a grid whose axes may wrap.

Felzenszwalb and Huttenlocher, Distance Transforms of Sampled Functions (2012), algorithm 1, one pass an axis;
a line that wraps is laid out twice, shifted by half a turn, so that both ways round are seen.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.kernel_cache import njit


def distance_to_false(
    inside: NDArray[np.bool_], spacing: Sequence[float] | NDArray[np.float64], wraps: Sequence[bool]
) -> NDArray[np.float64]:
    """Distance of each cell's centre to that of the nearest False cell; inf where there is none.

    Args:
        inside: any shape.
        spacing: size of a cell along each axis.
        wraps: whether the axis is a circle.
    """
    squared = np.where(inside, np.inf, 0.0)
    for axis, (step, circle) in enumerate(zip(spacing, wraps, strict=True)):
        outer, size = int(np.prod(inside.shape[:axis])), inside.shape[axis]
        _pass(squared.reshape(outer, size, -1), float(step) ** 2, bool(circle))
    return np.asarray(np.sqrt(squared))


@njit(cache=True, nogil=True)
def _pass(values, weight, wraps):  # type: ignore[no-untyped-def]
    """One pass of the squared transform along the middle axis, in place."""
    outer, size, inner = values.shape
    line, hull, breaks = np.empty(2 * size), np.empty(2 * size, dtype=np.int64), np.empty(2 * size)
    shift = size // 2 if wraps else 0
    length = 2 * size if wraps else size
    for first in range(outer):
        for last in range(inner):
            for at in range(length):
                line[at] = values[first, (at - shift) % size, last]
            parts = _envelope(line[:length], weight, hull, breaks)
            if parts > 0:
                _evaluate(values[first, :, last], shift, line, weight, hull, breaks, parts)


@njit(cache=True, nogil=True)
def _envelope(line, weight, hull, breaks):  # type: ignore[no-untyped-def]
    """Which of the parabolas line[j] + weight (i - j)^2 are lowest somewhere, and from where; how many."""
    parts = 0
    for at in range(line.shape[0]):
        if line[at] == np.inf:
            continue
        start = -np.inf
        while parts > 0:
            last = hull[parts - 1]
            start = (line[at] - line[last] + weight * (at * at - last * last)) / (2.0 * weight * (at - last))
            if start > breaks[parts - 1]:
                break
            parts -= 1
        hull[parts] = at
        breaks[parts] = start if parts > 0 else -np.inf
        parts += 1
    return parts


@njit(cache=True, nogil=True)
def _evaluate(values, shift, line, weight, hull, breaks, parts):  # type: ignore[no-untyped-def]
    part = 0
    for cell in range(values.shape[0]):
        at = cell + shift
        while part + 1 < parts and breaks[part + 1] < at:
            part += 1
        gap = at - hull[part]
        values[cell] = line[hull[part]] + weight * gap * gap
