"""A bundle's validity head: its graph, asked about many configurations."""

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.running.chunks import Between, chunked
from cspace.bundle.running.graphs import Graph
from cspace.bundle.samples import Picture
from cspace.bundle.spec import MAP
from cspace.errors import BundleError

CONFIDENCE, UNSEEN = "confidence", "unseen"


class Head:
    """See the module."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.tells_unseen = graph.gives(UNSEEN)
        self._told = (CONFIDENCE, UNSEEN) if self.tells_unseen else (CONFIDENCE,)

    def told(
        self, picture: Picture, configurations: NDArray[np.float32], between: Between | None
    ) -> NDArray[np.float32]:
        """Confidence in (n, d) rad, (n,), or (n, 2) with the unseen share beside it where that is told.

        Raises:
            BundleError: the graph fails, or gives what is no probability.
        """
        fixed = {"image": picture.pixels}
        if picture.map is not None and self._graph.takes(MAP):
            fixed[MAP] = picture.map

        def run(rows: slice) -> NDArray[np.float32]:
            part = configurations[rows]
            shapes = dict.fromkeys(self._told, (len(part),))
            found = self._graph.run(fixed | {"configurations": part}, shapes)
            if len(self._told) == 1:
                return found[CONFIDENCE]
            return np.stack([found[name] for name in self._told], axis=1)

        found = chunked(run, len(configurations), between)
        if np.any((found < 0.0) | (found > 1.0)):
            raise BundleError("the validity head gives no probabilities", expected="values from 0 to 1")
        return found
