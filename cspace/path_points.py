"""Points along a path, by their shares of its length."""

import numpy as np
from numpy.typing import NDArray

from cspace.space import JointSpace


def spread_points(path: NDArray[np.float64], count: int, space: JointSpace) -> NDArray[np.float64]:
    """``count`` points at equal distances along a path, its ends included.

    Args:
        path: (k, d) rad, k at least 2.
        count: at least 2.
        space: of the path.

    Returns:
        (count, d) rad, periodic joints in [-pi, pi).
    """
    return points_along(path, np.linspace(0.0, 1.0, count), space)


def points_along(
    path: NDArray[np.float64], shares: NDArray[np.float64], space: JointSpace
) -> NDArray[np.float64]:
    """The points at some shares (n,) of a path's length, 0 to 1, (n, d) rad."""
    steps = space.difference(path[:-1], path[1:])
    lengths = np.linalg.norm(steps, axis=1)
    reached = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.asarray(shares) * reached[-1]
    edge = np.clip(np.searchsorted(reached, wanted, side="right") - 1, 0, len(steps) - 1)
    along = (wanted - reached[edge]) / np.maximum(lengths[edge], np.finfo(np.float64).tiny)
    return space.wrap(path[edge] + np.clip(along, 0.0, 1.0)[:, None] * steps[edge])
