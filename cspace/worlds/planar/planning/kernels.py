"""Collision checks of an arm among discs: one numba kernel, for single states, batches and edges alike.

``pairs`` are the links that collide with each other, (K, 2) int64. For None, where none do, numba compiles
kernels of their own, which lose no time on it.
"""

import numpy as np

from cspace.kernel_cache import njit

TWO_PI = 2.0 * np.pi
# Sine of the angle up to which two lines count as parallel.
_PARALLEL = 1e-9


@njit(cache=True, nogil=True)
def segment_gap(ax, ay, bx, by, cx, cy, dx, dy):  # type: ignore[no-untyped-def]
    """Distance between the segments from a to b and from c to d; 0 where they cross.

    Those that do not cross are nearest at an end of one of them.
    """
    ux, uy, vx, vy = bx - ax, by - ay, dx - cx, dy - cy
    turn = ux * vy - uy * vx
    # Rounding lets parallel lines cross anywhere, and their ends tell the distance anyway.
    if turn * turn > (_PARALLEL * _PARALLEL) * (ux * ux + uy * uy) * (vx * vx + vy * vy):
        first = ((cx - ax) * vy - (cy - ay) * vx) / turn
        second = ((cx - ax) * uy - (cy - ay) * ux) / turn
        if 0.0 <= first <= 1.0 and 0.0 <= second <= 1.0:
            return 0.0
    from_first = min(_point_gap(ax, ay, cx, cy, dx, dy), _point_gap(bx, by, cx, cy, dx, dy))
    from_second = min(_point_gap(cx, cy, ax, ay, bx, by), _point_gap(dx, dy, ax, ay, bx, by))
    return min(from_first, from_second)


@njit(cache=True, nogil=True)
def _point_gap(px, py, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Distance of a point to the segment from a to b."""
    dx, dy = bx - ax, by - ay
    along = ((px - ax) * dx + (py - ay) * dy) / (dx * dx + dy * dy)
    along = min(1.0, max(0.0, along))
    return np.hypot(px - ax - along * dx, py - ay - along * dy)


@njit(cache=True, nogil=True)
def self_clearance(q, links, half_width, pairs):  # type: ignore[no-untyped-def]
    """Smallest distance between the capsules of the links of a pair, m."""
    count = links.shape[0]
    x, y, heading = np.zeros(count + 1), np.zeros(count + 1), 0.0
    for joint in range(count):
        heading += q[joint]
        x[joint + 1] = x[joint] + links[joint] * np.cos(heading)
        y[joint + 1] = y[joint] + links[joint] * np.sin(heading)
    least = np.inf
    for pair in range(pairs.shape[0]):
        i, j = pairs[pair, 0], pairs[pair, 1]
        gap = segment_gap(x[i], y[i], x[i + 1], y[i + 1], x[j], y[j], x[j + 1], y[j + 1])
        least = min(least, gap)
    return least - 2.0 * half_width


@njit(cache=True, nogil=True)
def arm_clearance(q, links, half_width, discs, pairs):  # type: ignore[no-untyped-def]
    """Smallest distance between the arm's capsules and the discs, m; inf without discs.

    No more than that between the capsules of the links of a pair.
    """
    clearance = np.inf
    if pairs is not None:
        clearance = self_clearance(q, links, half_width, pairs)
    x0, y0, heading = 0.0, 0.0, 0.0
    for joint in range(links.shape[0]):
        heading += q[joint]
        dx, dy = links[joint] * np.cos(heading), links[joint] * np.sin(heading)
        for disc in range(discs.shape[0]):
            px, py = discs[disc, 0] - x0, discs[disc, 1] - y0
            along = (px * dx + py * dy) / (dx * dx + dy * dy)
            along = min(1.0, max(0.0, along))
            gap = np.hypot(px - along * dx, py - along * dy) - discs[disc, 2] - half_width
            clearance = min(clearance, gap)
        x0 += dx
        y0 += dy
    return clearance


@njit(cache=True, nogil=True)
def arm_is_free(q, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether one configuration (d,) is within its limits, clear of every disc and of itself."""
    for joint in range(links.shape[0]):
        if not periodic[joint] and not lower[joint] <= q[joint] <= upper[joint]:
            return False
    return arm_clearance(q, links, half_width, discs, pairs) > 0.0


@njit(cache=True, nogil=True)
def checked_edge(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped segment from ``a`` to ``b`` is free, and how many states were looked at.

    Both ends are included. Neighbouring states are at most ``resolution`` rad apart in every joint. They are
    looked at in the order of a bisection, which finds collisions sooner and changes no result.
    """
    dim = links.shape[0]
    step = np.empty(dim)
    longest = 0.0
    for joint in range(dim):
        step[joint] = b[joint] - a[joint]
        if periodic[joint]:
            step[joint] = (step[joint] + np.pi) % TWO_PI - np.pi
        longest = max(longest, abs(step[joint]))
    count = max(1, int(np.ceil(longest / resolution)))
    q = np.empty(dim)
    stride = 1
    while stride < count:
        stride *= 2
    first, looked = True, 0
    while stride >= 1:
        start, jump = (0, stride) if first else (stride, 2 * stride)
        for index in range(start, count + 1, jump):
            for joint in range(dim):
                q[joint] = a[joint] + step[joint] * index / count
            looked += 1
            if not arm_is_free(q, links, half_width, discs, pairs, lower, upper, periodic):
                return False, looked
        first = False
        stride //= 2
    for joint in range(dim):
        q[joint] = a[joint] + step[joint]
    return arm_is_free(q, links, half_width, discs, pairs, lower, upper, periodic), looked + 1


@njit(cache=True, nogil=True)
def edge_is_free(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Whether the straight wrapped segment from ``a`` to ``b`` is free, both ends included."""
    return checked_edge(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic)[0]


@njit(cache=True, nogil=True)
def clearance_batch(q, links, half_width, discs, pairs):  # type: ignore[no-untyped-def]
    """Clearance of each of (N, d), (N,) m."""
    out = np.empty(q.shape[0])
    for row in range(q.shape[0]):
        out[row] = arm_clearance(q[row], links, half_width, discs, pairs)
    return out


@njit(cache=True, nogil=True)
def free_batch(q, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Which of (N, d) are free, (N,)."""
    out = np.empty(q.shape[0], dtype=np.bool_)
    for row in range(q.shape[0]):
        out[row] = arm_is_free(q[row], links, half_width, discs, pairs, lower, upper, periodic)
    return out


@njit(cache=True, nogil=True)
def edge_batch(a, b, resolution, links, half_width, discs, pairs, lower, upper, periodic):  # type: ignore[no-untyped-def]
    """Which segments between (N, d) and (N, d) are free, (N,)."""
    out = np.empty(a.shape[0], dtype=np.bool_)
    for row in range(a.shape[0]):
        out[row] = edge_is_free(
            a[row], b[row], resolution, links, half_width, discs, pairs, lower, upper, periodic
        )
    return out
