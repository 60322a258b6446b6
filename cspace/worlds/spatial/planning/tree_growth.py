"""The inner loop of RRT-Connect, compiled with the arm's checks.

Source: Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000, with
the metric (the sum over the joints) and the order of OMPL's.
"""

import numpy as np

from cspace.kernel_cache import njit
from cspace.worlds.spatial.planning.kernels import TWO_PI, checked_edge, gap, room_of, state_is_free

_TRAPPED, _ADVANCED, _REACHED = 0, 1, 2


@njit(cache=True, nogil=True)
def advance(nodes, parents, counts, checks, states, side, reach, resolution, scene):  # type: ignore[no-untyped-def]
    """Grow by a block of states: iterations, whose turn it is, the shared node or -1 twice.

    ``checks`` counts on: edges, and states within them and alone.
    """
    room = room_of(scene)
    for index in range(states.shape[0]):
        other = 1 - side
        status = _grow(nodes, parents, counts, checks, side, states[index], reach, resolution, scene, room)
        if status != _TRAPPED:
            target = nodes[side, counts[side] - 1].copy()
            status = _ADVANCED
            while status == _ADVANCED:
                status = _grow(nodes, parents, counts, checks, other, target, reach, resolution, scene, room)
            if status == _REACHED:
                return index + 1, other, counts[0] - 1, counts[1] - 1
        side = other
    return states.shape[0], side, -1, -1


@njit(cache=True, nogil=True)
def _grow(nodes, parents, counts, checks, side, target, reach, resolution, scene, room):  # type: ignore[no-untyped-def]
    """One step of a tree towards a configuration: trapped, advanced or reached."""
    dim = target.shape[0]
    if counts[side] == nodes.shape[1]:
        return _TRAPPED
    nearest, least = _nearest(nodes[side], counts[side], target, scene.periodic)
    share = min(1.0, reach / least) if least > 0.0 else 1.0
    new = np.empty(dim)
    for joint in range(dim):
        begin = nodes[side, nearest, joint]
        new[joint] = begin + share * gap(begin, target[joint], scene.periodic[joint])
        if scene.periodic[joint]:
            new[joint] = (new[joint] + np.pi) % TWO_PI - np.pi
    if share == 1.0:
        new[:] = target
    # The goal's tree looks at the new state before its edge, as OMPL's does.
    if side == 1:
        checks[1] += 1
        if not state_is_free(new, scene, room):
            return _TRAPPED
    free, states = checked_edge(nodes[side, nearest], new, resolution, scene, room)
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
            distance += abs(gap(nodes[node, joint], target[joint], periodic[joint]))
        if distance < least:
            nearest, least = node, distance
    return nearest, least
