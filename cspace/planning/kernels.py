"""The compiled half of planning, shared by all simulators: edge check, RRT-Connect, shortcuts.

A simulator brings its state check; :class:`SceneKernels` compiles the rest around it. Sources: Kuffner and
LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000, with the metric (the sum
over the joints) and the order of OMPL's; Geraerts and Overmars, Creating High-Quality Paths for Motion
Planning, IJRR 26 (2007), for shortcuts.
"""

from typing import Any

import numpy as np

from cspace.kernel_cache import njit

TWO_PI = 2.0 * np.pi
_TRAPPED, _ADVANCED, _REACHED = 0, 1, 2
# Gains, as shares of the length, below which shortcuts are not checked.
_LEAST_GAIN = 1e-4
_SAME_RAD = 1e-9


class SceneKernels:
    """Compiled checks and searches of a simulator.

    A simulator's kernels take a configuration (d,), a scene and a room. ``scene`` is a named tuple of arrays
    with ``lower``, ``upper`` (d,) rad and ``periodic`` (d,) bool among them; ``room`` is what a state check
    works in.
    """

    def __init__(self, state_is_free: Any, state_clearance: Any, room_of: Any) -> None:
        self.state_is_free, self.room_of = state_is_free, room_of
        self.checked_edge = _edge_check(state_is_free)
        self.free_batch, self.clearance_batch, self.edge_batch = _batches(
            state_is_free, state_clearance, self.checked_edge, room_of
        )
        self.grow_trees = _tree_growth(_tree_step(state_is_free, self.checked_edge), room_of)
        self.shortened = _shortcutting(self.checked_edge, room_of)


@njit(cache=True, nogil=True, error_model="numpy")
def gap(begin, end, wraps):  # type: ignore[no-untyped-def]
    """The difference from one angle to another, on the shorter side of a circle."""
    found = end - begin
    return (found + np.pi) % TWO_PI - np.pi if wraps else found


def _edge_check(state_is_free: Any) -> Any:
    @njit(cache=True, nogil=True, error_model="numpy")
    def checked_edge(a, b, resolution, scene, room):  # type: ignore[no-untyped-def]
        """Whether the straight wrapped edge from ``a`` to ``b`` is free, and how many states were checked.

        Both ends are included. Neighbouring states are at most ``resolution`` rad apart in every joint. They
        are checked in the order of a bisection, which finds collisions sooner and changes no result.
        """
        dim = a.shape[0]
        step, q = np.empty(dim), np.empty(dim)
        longest = 0.0
        for joint in range(dim):
            step[joint] = gap(a[joint], b[joint], scene.periodic[joint])
            longest = max(longest, abs(step[joint]))
        count = max(1, int(np.ceil(longest / resolution)))
        stride = 1
        while stride < count:
            stride *= 2
        begin, jump, looked = 0, stride, 0
        while stride >= 1:
            for index in range(begin, count + 1, jump):
                for joint in range(dim):
                    q[joint] = a[joint] + step[joint] * index / count
                looked += 1
                if not state_is_free(q, scene, room):
                    return False, looked
            begin, jump = stride // 2, stride
            stride //= 2
        for joint in range(dim):
            q[joint] = a[joint] + step[joint]
        return state_is_free(q, scene, room), looked + 1

    return checked_edge


def _batches(
    state_is_free: Any, state_clearance: Any, checked_edge: Any, room_of: Any
) -> tuple[Any, Any, Any]:
    @njit(cache=True, nogil=True, error_model="numpy")
    def free_batch(q, scene):  # type: ignore[no-untyped-def]
        """Which of (N, d) are free, (N,)."""
        out, room = np.empty(q.shape[0], dtype=np.bool_), room_of(scene)
        for row in range(q.shape[0]):
            out[row] = state_is_free(q[row], scene, room)
        return out

    @njit(cache=True, nogil=True, error_model="numpy")
    def clearance_batch(q, scene):  # type: ignore[no-untyped-def]
        """Clearance of each of (N, d), (N,) m."""
        out, room = np.empty(q.shape[0]), room_of(scene)
        for row in range(q.shape[0]):
            out[row] = state_clearance(q[row], scene, room)
        return out

    @njit(cache=True, nogil=True, error_model="numpy")
    def edge_batch(a, b, resolution, scene):  # type: ignore[no-untyped-def]
        """Which edges between (N, d) and (N, d) are free, (N,)."""
        out, room = np.empty(a.shape[0], dtype=np.bool_), room_of(scene)
        for row in range(a.shape[0]):
            out[row] = checked_edge(a[row], b[row], resolution, scene, room)[0]
        return out

    return free_batch, clearance_batch, edge_batch


def _tree_step(state_is_free: Any, checked_edge: Any) -> Any:
    @njit(cache=True, nogil=True)
    def step(nodes, parents, counts, checks, side, target, reach, resolution, scene, room):  # type: ignore[no-untyped-def]
        """One step of a tree towards a configuration: trapped, advanced or reached."""
        if counts[side] == nodes.shape[1]:
            return _TRAPPED
        new = np.empty(target.shape[0])
        nearest, share = _steered(nodes[side], counts[side], target, reach, scene.periodic, new)
        # The goal's tree checks the new state before its edge, as OMPL's does.
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

    return step


def _tree_growth(step: Any, room_of: Any) -> Any:
    @njit(cache=True, nogil=True)
    def grow_trees(nodes, parents, counts, checks, states, side, reach, resolution, scene):  # type: ignore[no-untyped-def]
        """See :meth:`cspace.simulator.Checker.grow_trees`."""
        room = room_of(scene)
        for index in range(states.shape[0]):
            other = 1 - side
            status = step(nodes, parents, counts, checks, side, states[index], reach, resolution, scene, room)
            if status != _TRAPPED:
                target = nodes[side, counts[side] - 1].copy()
                status = _ADVANCED
                while status == _ADVANCED:
                    status = step(
                        nodes, parents, counts, checks, other, target, reach, resolution, scene, room
                    )
                if status == _REACHED:
                    return index + 1, other, counts[0] - 1, counts[1] - 1
            side = other
        return states.shape[0], side, -1, -1

    return grow_trees


@njit(cache=True, nogil=True)
def _steered(nodes, count, target, reach, periodic, new):  # type: ignore[no-untyped-def]
    """Fill in the state towards a target from the nearest node; that node, and the share of the path."""
    dim, nearest, least = target.shape[0], 0, np.inf
    for node in range(count):
        distance = 0.0
        for joint in range(dim):
            distance += abs(gap(nodes[node, joint], target[joint], periodic[joint]))
        if distance < least:
            nearest, least = node, distance
    share = min(1.0, reach / least) if least > 0.0 else 1.0
    for joint in range(dim):
        begin = nodes[nearest, joint]
        new[joint] = begin + share * gap(begin, target[joint], periodic[joint])
        if periodic[joint]:
            new[joint] = (new[joint] + np.pi) % TWO_PI - np.pi
    if share == 1.0:
        new[:] = target
    return nearest, share


def _shortcutting(checked_edge: Any, room_of: Any) -> Any:
    @njit(cache=True, nogil=True, error_model="numpy")
    def shortened(path, draws, resolution, scene):  # type: ignore[no-untyped-def]
        """The path after shortcuts (N, 2): where each begins and its span, as shares of the length."""
        room, periodic = room_of(scene), scene.periodic
        now, count = np.empty((path.shape[0] + draws.shape[0], path.shape[1])), path.shape[0]
        now[:count] = path
        reached, first, last = np.zeros(now.shape[0]), np.empty(path.shape[1]), np.empty(path.shape[1])
        for index in range(draws.shape[0]):
            for node in range(1, count):
                reached[node] = reached[node - 1] + _distance(now[node - 1], now[node], periodic)
            whole = reached[count - 1]
            span = draws[index, 1] * whole
            begin = draws[index, 0] * (whole + span) - span
            begin, end = max(begin, 0.0), min(begin + span, whole)
            i = _point(now, count, reached, begin, periodic, first)
            j = _point(now, count, reached, end, periodic, last)
            gain = end - begin - _distance(first, last, periodic)
            if (
                i == j
                or gain < _LEAST_GAIN * whole
                or not checked_edge(first, last, resolution, scene, room)[0]
            ):
                continue
            rest, at = now[j + 1 : count].copy(), i + 1
            for point, node in ((first, now[i]), (last, rest[0])):
                # A point at a node is that node.
                if _distance(point, node, periodic) > _SAME_RAD:
                    now[at] = point
                    at += 1
            count = at + rest.shape[0]
            now[at:count] = rest
        return now[:count].copy()

    return shortened


@njit(cache=True, nogil=True, error_model="numpy")
def _point(path, count, reached, along, periodic, out):  # type: ignore[no-untyped-def]
    """Fill in the point at a distance along the path; the edge that it lies on."""
    edge = 0
    while edge < count - 2 and reached[edge + 1] < along:
        edge += 1
    length = reached[edge + 1] - reached[edge]
    share = min(max((along - reached[edge]) / length, 0.0), 1.0) if length > 0.0 else 0.0
    for joint in range(path.shape[1]):
        out[joint] = path[edge, joint] + share * gap(
            path[edge, joint], path[edge + 1, joint], periodic[joint]
        )
    return edge


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(first, second, periodic):  # type: ignore[no-untyped-def]
    square = 0.0
    for joint in range(first.shape[0]):
        square += gap(first[joint], second[joint], periodic[joint]) ** 2
    return np.sqrt(square)
