"""Refines paths until a model gives them less cost."""

from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from cspace.planning.cost import Predict, ScoredPath, costs_of, score
from cspace.planning.paths import shortcut
from cspace.planning.search import OutOfTimeError
from cspace.simulator import Checker
from cspace.world import CheckCancelled

# That a rad costs beside its cost: of two paths of one cost the shorter is taken.
_PER_RAD = 0.02
# Of the draws about a path, each joint, rad.
_SPREADS_RAD = (0.1, 0.3)
# Neighbours of each configuration that are joined to it, and how far away they may be, Euclidean.
_NEIGHBOURS, _REACH_RAD = 12, 1.0
# Draws for each that is wanted, for some are no configurations that the picture leaves free.
_SPARE = 1.4
# Paths that may turn out to be blocked or costlier than they seemed, in each round.
_TRIES = 12
# More cost at an edge's middle than its ends have, times its length, for which another path is looked for.
_SURPRISE = 0.01
# Times that so many shortcuts are tried in the end.
_SHORTER, _SHORTCUTS = 2, 16


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is done for a lower cost."""

    paths: int = 4  # those of lowest cost, which are changed
    rounds: int = 4  # for each of them
    states: int = 75  # drawn about it in each round
    step_rad: float = 0.15  # between states that the model is asked about
    check_rad: float = 0.03  # between states that are checked by the picture, the largest over the joints
    enough: float = 0.02  # cost at which a path is left as it is


@dataclass(frozen=True, slots=True, eq=False)
class _Graph:
    """Configurations about a path."""

    nodes: NDArray[np.float64]  # (n, d) rad, the first of them the path's
    node_costs: NDArray[np.float64]  # (n,)
    lengths: NDArray[np.float64]  # (n, n) between them, rad
    costs: NDArray[np.float64]  # (n, n) of straight edges, inf without one; changed by what is found out
    own: int  # how many are the path's


class PathRefiner:
    """Lowers the cost of paths in one scene."""

    def __init__(
        self,
        checker: Checker,
        predict: Predict,
        plan_calibration: tuple[float, float],
        effort: Effort,
        check_cancelled: CheckCancelled,
    ) -> None:
        self._checker, self._space, self._predict = checker, checker.space, predict
        self._plan_calibration, self._check_cancelled, self.effort = plan_calibration, check_cancelled, effort

    def refine(self, path: ScoredPath, rng: np.random.Generator) -> ScoredPath:
        """A path with the same ends of no higher cost; as far as it came where the time is over."""
        try:
            for _ in range(self.effort.rounds):
                if path.cost <= self.effort.enough:
                    return path
                self._check_cancelled()
                path = self._better(path, self._through(self._graph(path, rng)))
            for _ in range(_SHORTER):
                path = self._better(path, self._shorter(path, rng))
        except OutOfTimeError:
            pass
        return path

    def _shorter(self, path: ScoredPath, rng: np.random.Generator) -> NDArray[np.float64]:
        return shortcut(self._checker, path.path, rng, _SHORTCUTS, self.effort.check_rad)

    def _better(self, path: ScoredPath, other: NDArray[np.float64] | None) -> ScoredPath:
        if other is None:
            return path
        (scored,) = score([other], self._space, self.effort.step_rad, self._predict, self._plan_calibration)
        return min(path, scored, key=lambda one: one.cost)

    def _graph(self, path: ScoredPath, rng: np.random.Generator) -> _Graph:
        count = int(_SPARE * self.effort.states)
        about = path.states[rng.integers(len(path.states), size=count)]
        spread = rng.choice(_SPREADS_RAD, size=(count, 1))
        sampled = self._space.bound(about + spread * rng.normal(size=about.shape))
        sampled = sampled[self._checker.valid_batch(sampled)][: self.effort.states]
        nodes = np.concatenate([path.states, sampled])
        costs = np.concatenate([path.costs, self._costs(sampled)])
        lengths = self._space.distance(nodes[:, None], nodes[None])
        joined = _neighbours(lengths) & (lengths <= _REACH_RAD)
        own = len(path.states)
        joined[np.arange(own - 1), np.arange(1, own)] = True
        joined |= joined.T
        each = lengths * (0.5 * (costs[:, None] + costs[None]) + _PER_RAD)
        return _Graph(nodes, costs, lengths, np.where(joined, each, np.inf), own)

    def _through(self, graph: _Graph) -> NDArray[np.float64] | None:
        """The path of lowest cost that is free and as it seemed, (k, d) rad; None without one."""
        known, predicted = (np.zeros(graph.costs.shape, dtype=np.bool_) for _ in range(2))
        ahead = np.arange(graph.own - 1)
        known[ahead, ahead + 1] = known[ahead + 1, ahead] = True
        predicted |= known | (graph.lengths <= self.effort.step_rad)
        for _ in range(_TRIES):
            route = cheapest_route(graph.costs, 0, graph.own - 1)
            if route is None:
                return None
            first, second = route[:-1], route[1:]
            if self._blocked(graph, first, second, known) or self._surprised(graph, first, second, predicted):
                continue
            return graph.nodes[route]
        return None

    def _blocked(
        self,
        graph: _Graph,
        first: NDArray[np.int64],
        second: NDArray[np.int64],
        known: NDArray[np.bool_],
    ) -> bool:
        """Check what is not known of edges; whether one of them is not free."""
        new = ~known[first, second]
        i, j = first[new], second[new]
        if not len(i):
            return False
        free = self._checker.edge_batch(graph.nodes[i], graph.nodes[j], self.effort.check_rad)
        known[i[free], j[free]] = known[j[free], i[free]] = True
        graph.costs[i[~free], j[~free]] = graph.costs[j[~free], i[~free]] = np.inf
        return not free.all()

    def _surprised(
        self,
        graph: _Graph,
        first: NDArray[np.int64],
        second: NDArray[np.int64],
        predicted: NDArray[np.bool_],
    ) -> bool:
        """Ask about the middles of edges; whether one is so much costlier than its ends."""
        new = ~predicted[first, second]
        i, j = first[new], second[new]
        if not len(i):
            return False
        step = self._space.difference(graph.nodes[i], graph.nodes[j])
        middles = self._costs(self._space.wrap(graph.nodes[i] + 0.5 * step))
        more = graph.lengths[i, j] * np.maximum(
            0.0, middles - 0.5 * (graph.node_costs[i] + graph.node_costs[j])
        )
        predicted[i, j] = predicted[j, i] = True
        graph.costs[i, j] += more
        graph.costs[j, i] = graph.costs[i, j]
        return bool(more.max() > _SURPRISE)

    def _costs(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        if not len(rows):
            return np.empty(0)
        return costs_of(self._predict(self._space.to_float32(rows))[0])


def cheapest_route(costs: NDArray[np.float64], start: int, goal: int) -> NDArray[np.int64] | None:
    """Nodes from start to goal at the least cost of edges (n, n), inf where there is none; None without."""
    # By name: who only reads bundles has no scipy.
    sparse, csgraph = import_module("scipy.sparse"), import_module("scipy.sparse.csgraph")
    rows, columns = np.nonzero(np.isfinite(costs))
    graph = sparse.csr_array((costs[rows, columns], (rows, columns)), shape=costs.shape)
    before = csgraph.dijkstra(graph, indices=start, return_predecessors=True)[1]
    route = [goal]
    while route[-1] != start:
        if before[route[-1]] < 0:
            return None
        route.append(int(before[route[-1]]))
    return np.array(route[::-1], dtype=np.int64)


def _neighbours(lengths: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of (n, n) are among the least of their row, the diagonal not among them."""
    distances = lengths + np.diag(np.full(len(lengths), np.inf))
    count = min(_NEIGHBOURS, len(lengths) - 1)
    nearest = np.argpartition(distances, count - 1, axis=1)[:, :count]
    found = np.zeros(lengths.shape, dtype=np.bool_)
    np.put_along_axis(found, nearest, values=True, axis=1)
    return found
