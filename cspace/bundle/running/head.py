"""A bundle's validity head: its graph, asked about many configurations."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.running.chunks import Between, chunked
from cspace.bundle.running.graphs import Graph
from cspace.bundle.samples import Picture
from cspace.bundle.spec import MAP, BundleSpec
from cspace.errors import BundleError
from cspace.plan import Seen

CONFIDENCE, UNSEEN = "confidence", "unseen"
# A head that reads arrays of space at hundreds of spheres a configuration is quickest while what it computes
# in between fits into a core's own cache: by 64 rows it takes 0.85 of the time that it takes by 512.
CACHED_ROWS = 64


class Head:
    """See the module."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.tells_unseen, self.looks_at_map = graph.gives(UNSEEN), graph.takes(MAP)
        self._told = (CONFIDENCE, UNSEEN) if self.tells_unseen else (CONFIDENCE,)

    def told(
        self, picture: Picture, configurations: NDArray[np.float32], between: Between | None
    ) -> NDArray[np.float32]:
        """Confidence in (n, d) rad, (n,), or (n, 2) with the unseen share beside it where that is told.

        Raises:
            BundleError: the graph fails, or gives what is no probability.
        """
        fixed = {"image": picture.pixels}
        if picture.map is not None and self.looks_at_map:
            fixed[MAP] = picture.map

        def scored(part: NDArray[np.float32]) -> Mapping[str, NDArray[np.float32]]:
            shapes = dict.fromkeys(self._told, (len(part),))
            return self._graph.run(fixed | {"configurations": part}, shapes)

        def run(rows: slice) -> NDArray[np.float32]:
            part = configurations[rows]
            if not self.tells_unseen:
                return scored(part)[CONFIDENCE]
            parts = []
            for first in range(0, len(part), CACHED_ROWS):
                parts.append(scored(part[first : first + CACHED_ROWS]))
                if between is not None:
                    between()
            told = [np.concatenate([one[name] for one in parts]) for name in self._told]
            return np.stack(told, axis=1)

        found = chunked(run, len(configurations), between)
        if np.any((found < 0.0) | (found > 1.0)):
            raise BundleError("the validity head gives no probabilities", expected="values from 0 to 1")
        return found

    def believe(
        self, picture: Picture, configurations: NDArray[np.float32], between: Between | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """The same, the unseen share apart: None where it is not told."""
        found = self.told(picture, configurations, between)
        return (found[:, 0], found[:, 1]) if self.tells_unseen else (found, None)

    def seen(self, spec: BundleSpec, picture: Picture, between: Between | None) -> Seen:
        """A picture of the bundle's as searches for ways take it."""
        return Seen(
            spec.world,
            spec.world.sensor.from_network(picture.pixels)[0],
            lambda rows: self.believe(picture, rows, between),
            spec.plan_doubt or (0.0, 1.0),
        )
