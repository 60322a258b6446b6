"""The inner loop of RRT-Connect, compiled with the arm's checks.

Source: Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000, with
the metric (the sum over the joints) and the order of OMPL's.
"""

import numpy as np

from cspace.kernel_cache import njit
from cspace.worlds.planar.planning.kernels import TWO_PI, arm_is_free, checked_edge

_TRAPPED, _ADVANCED, _REACHED = 0, 1, 2


@njit(cache=True, nogil=True)
def advance(  # type: ignore[no-untyped-def]
    nodes, parents, counts, checks, states, side, reach, resolution,
    links, half_width, discs, pairs, lower, upper, periodic,
):  # fmt: skip
    """Grow by a block of states: iterations, whose turn it is, the shared node or -1 twice.

    ``checks`` counts on: edges, and states within them and alone.
    """
    for index in range(states.shape[0]):
        other = 1 - side
        status = _grow(
            nodes, parents, counts, checks, side, states[index], reach, resolution,
            links, half_width, discs, pairs, lower, upper, periodic,
        )  # fmt: skip
        if status != _TRAPPED:
            target = nodes[side, counts[side] - 1].copy()
            status = _ADVANCED
            while status == _ADVANCED:
                status = _grow(
                    nodes, parents, counts, checks, other, target, reach, resolution,
                    links, half_width, discs, pairs, lower, upper, periodic,
                )  # fmt: skip
            if status == _REACHED:
                first, second = counts[0] - 1, counts[1] - 1
                return index + 1, other, first, second
        side = other
    return states.shape[0], side, -1, -1


@njit(cache=True, nogil=True)
def _grow(  # type: ignore[no-untyped-def]
    nodes, parents, counts, checks, side, target, reach, resolution,
    links, half_width, discs, pairs, lower, upper, periodic,
):  # fmt: skip
    """One step of a tree towards a configuration: trapped, advanced or reached."""
    dim = target.shape[0]
    if counts[side] == nodes.shape[1]:
        return _TRAPPED
    nearest, least = _nearest(nodes[side], counts[side], target, periodic)
    share = min(1.0, reach / least) if least > 0.0 else 1.0
    new = np.empty(dim)
    for joint in range(dim):
        begin = nodes[side, nearest, joint]
        new[joint] = begin + share * _gap(begin, target[joint], periodic[joint])
        if periodic[joint]:
            new[joint] = (new[joint] + np.pi) % TWO_PI - np.pi
    if share == 1.0:
        new[:] = target
    # The goal's tree looks at the new state before its edge, as OMPL's does.
    if side == 1:
        checks[1] += 1
        if not arm_is_free(new, links, half_width, discs, pairs, lower, upper, periodic):
            return _TRAPPED
    free, states = checked_edge(
        nodes[side, nearest], new, resolution,
        links, half_width, discs, pairs, lower, upper, periodic,
    )  # fmt: skip
    checks[0] += 1
    checks[1] += states
    if not free:
        return _TRAPPED
    nodes[side, counts[side]] = new
    parents[side, counts[side]] = nearest
    counts[side] += 1
    return _REACHED if share == 1.0 else _ADVANCED


@njit(cache=True, nogil=True)
def _nearest(nodes, count, target, periodic):  # type: ignore[no-untyped-def]
    """The node that is nearest by the sum over the joints, and how far it is."""
    nearest, least = 0, np.inf
    for node in range(count):
        distance = 0.0
        for joint in range(target.shape[0]):
            distance += abs(_gap(nodes[node, joint], target[joint], periodic[joint]))
        if distance < least:
            nearest, least = node, distance
    return nearest, least


@njit(cache=True, nogil=True)
def _gap(begin, end, wraps):  # type: ignore[no-untyped-def]
    """The way from one angle to another, the shorter one on a circle."""
    gap = end - begin
    return (gap + np.pi) % TWO_PI - np.pi if wraps else gap
