"""The motions that a planner found free, as a graph: a PRM joins its milestones by just these.

So Python knows when start and goal are one component, without a look into OMPL's roadmap.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from cspace.simulator import Checker
from cspace.space import JointSpace
from services.planner.plan_result import SearchTree
from services.planner.search.validity import EdgeValidator


class Roadmap(EdgeValidator):
    """Checks motions and keeps those that are free.

    Args:
        information: OMPL's space information.
        checker: of the scenario.
        resolution_rad: largest distance between checked states in any joint.
    """

    def __init__(self, information: Any, checker: Checker, resolution_rad: float) -> None:
        super().__init__(information, checker, resolution_rad)
        # Milestones by the bits of their angles, as OMPL copies these; equal ones are one here.
        self._numbers: dict[bytes, int] = {}
        self._parents: list[int] = []
        self._edges: list[tuple[int, int]] = []

    def checkMotion(self, start: Any, end: Any) -> bool:  # noqa: N802 - OMPL's name
        """Whether the motion is free, both ends included."""
        free = super().checkMotion(start, end)
        if free:
            first, second = self.number(self._from), self.number(self._to)
            if first != second:
                self._edges.append((first, second))
                self._parents[self._root(first)] = self._root(second)
        return free

    def number(self, milestone: NDArray[np.float64]) -> int:
        """The number of a milestone (d,) rad, a new one if it is new."""
        number = self._numbers.setdefault(milestone.tobytes(), len(self._parents))
        if number == len(self._parents):
            self._parents.append(number)
        return number

    def joined(self, first: int, second: int) -> bool:
        """Whether edges lead from one milestone to another."""
        return self._root(first) == self._root(second)

    def shortest_path(self, space: JointSpace, first: int, second: int) -> NDArray[np.float64]:
        """The shortest way (torus length, L2) between two joined milestones, (k, d) rad."""
        rows = self._rows()
        # Twice the same pair would count twice in the sparse matrix.
        edges = np.unique(np.sort(np.array(self._edges, dtype=np.intp), axis=1), axis=0)
        lengths = space.distance(rows[edges[:, 0]], rows[edges[:, 1]])
        graph = csr_array((lengths, edges.T), shape=(len(rows), len(rows)))
        _, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
        numbers = [second]
        while numbers[-1] != first:
            numbers.append(int(before[numbers[-1]]))
        return rows[numbers[::-1]].copy()

    def copy(self) -> SearchTree:
        """All states and all free motions."""
        return SearchTree(self._rows().copy(), np.array(self._edges, dtype=np.intp).reshape(-1, 2))

    def _rows(self) -> NDArray[np.float64]:
        return np.frombuffer(b"".join(self._numbers), dtype=np.float64).reshape(-1, len(self._from))

    def _root(self, number: int) -> int:
        while self._parents[number] != number:
            self._parents[number] = self._parents[self._parents[number]]
            number = self._parents[number]
        return number
