"""Compile the search of plans ahead: ``python -m cspace.planning.compiled``, for images of servers.

What is compiled lies in numba's cache (``NUMBA_CACHE_DIR``), for processors like this one.
"""

import sys

import numpy as np
from numpy.typing import NDArray

from cspace.connecting import connect_trees
from cspace.planning.less_doubt import route_search
from cspace.workshop import Checker
from cspace.worlds import examples, seen_checkers


def load_kernels(checker: Checker, configuration: NDArray[np.float64], step_rad: float) -> None:
    """Have a checker's compiled code in this process: a first call loads it, or compiles it.

    Args:
        checker: of any scene.
        configuration: (d,) rad.
        step_rad: above 0.
    """
    checker.valid_batch(configuration[None])
    checker.edge_batch(configuration[None], configuration[None], step_rad)
    ends = configuration, configuration
    connect_trees(checker, *ends, configuration[None], range_rad=step_rad, resolution_rad=step_rad)
    route_search()(np.zeros((1, 1)), 0, 0)


def load_examples() -> list[str]:
    """Have the compiled code of the worlds of every kind in this process; returns the examples' names."""
    for world in examples().values():
        nothing = np.zeros(world.sensor.picture_shape, dtype=np.uint8)
        ends = np.zeros((2, world.dim))
        load_kernels(seen_checkers(world, nothing, ends)[0], ends[0], 0.1)
    return list(examples())


def main() -> int:
    """Compile for every example; returns the exit code."""
    sys.stdout.write(f"compiled for {', '.join(load_examples())}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
