"""The order in which a planner's tree can use samples that lie along a path: from the start on.

Samplers give a cloud. Its chains of short hops from start to goal tell how far along each sample lies, and a
tree that takes the samples from the start on can reach nearly each one from the one before.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.kernel_cache import njit
from cspace.simulator import Checker
from cspace.space import JointSpace
from cspace_client.ompl.sample_mixture import free_first

SWEEP = 24
# Of a hop's length: many short hops cost less than one long one, so that chains stay within the cloud.
_POWER = 3


def order_along(
    samples: ArrayLike, start: ArrayLike, goal: ArrayLike, space: JointSpace, sweep: int = SWEEP
) -> NDArray[np.intp]:
    """The order of samples in sweeps from start to goal.

    Args:
        samples: (n, d) rad.
        start: (d,) rad.
        goal: (d,) rad.
        space: the joint space.
        sweep: samples from start to goal before the next begin at the start again.

    Returns:
        (n,) a permutation: every sweep rises from start to goal, and all are about equally long.
    """
    rows = np.asarray(samples, dtype=np.float64)
    if len(rows) == 0:
        return np.empty(0, dtype=np.intp)
    points = np.ascontiguousarray(space.wrap(np.concatenate([[start], rows, [goal]])))
    wraps = np.array(space.periodic, dtype=np.bool_)
    behind, ahead = _costs(points, wraps, 0)[1:-1], _costs(points, wraps, len(points) - 1)[1:-1]
    along = np.argsort(behind / np.maximum(behind + ahead, np.finfo(np.float64).tiny), kind="stable")
    sweeps = -(-len(rows) // max(1, sweep))
    rank = np.arange(len(rows))
    return np.asarray(along[np.argsort(rank % sweeps, kind="stable")], dtype=np.intp)


def colliding_last(samples: ArrayLike, checker: Checker) -> NDArray[np.intp]:
    """The order of samples in which those that collide come after all others; else it stays as it is.

    Args:
        samples: (n, d) rad.
        checker: of the scenario.

    Returns:
        (n,) a permutation.
    """
    rows = checker.space.wrap(np.asarray(samples, dtype=np.float64))
    free = checker.valid_batch(rows).tolist()
    return np.fromiter(free_first(range(len(free)), free.__getitem__), dtype=np.intp)


@njit(cache=True, nogil=True)
def _costs(points, wraps, source):  # type: ignore[no-untyped-def]
    """Cost of the cheapest chain of hops from each of (n, d) points to one of them, (n,)."""
    count, dim = points.shape
    costs = np.full(count, np.inf)
    costs[source] = 0.0
    done = np.zeros(count, dtype=np.bool_)
    for _ in range(count):
        at, least = -1, np.inf
        for index in range(count):
            if not done[index] and costs[index] < least:
                at, least = index, costs[index]
        done[at] = True
        for index in range(count):
            if done[index]:
                continue
            squared = 0.0
            for joint in range(dim):
                gap = abs(points[index, joint] - points[at, joint])
                if wraps[joint]:
                    gap = min(gap, 2.0 * np.pi - gap)
                squared += gap * gap
            costs[index] = min(costs[index], least + squared ** (_POWER / 2.0))
    return costs
