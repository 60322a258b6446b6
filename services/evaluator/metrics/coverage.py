"""Coverage: the share of the free space that samples are near to."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cspace.space import JointSpace
from services.evaluator.metrics import Samples, metric


@metric("coverage")
def coverage(group: Samples) -> float:
    """Share of held-out configurations with a sample within a radius, round the circles."""
    return float(np.mean(covered(group.held_out, group.samples, group.space, group.coverage_radius_rad)))


def covered(
    held_out: NDArray[np.floating], samples: NDArray[np.floating], space: JointSpace, radius_rad: float
) -> NDArray[np.bool_]:
    """Which of (M, d) held-out configurations have one of (N, d) samples within a radius, (M,)."""
    nearest, _ = neighbour_tree(samples, space).query(_from_zero(held_out, space))
    return np.asarray(nearest <= radius_rad)


def neighbour_tree(configurations: NDArray[np.floating], space: JointSpace) -> cKDTree:
    """A tree of (N, d) configurations in the joint space's own metric."""
    # A period of 0 tells the tree that a joint is no circle.
    return cKDTree(_from_zero(configurations, space), boxsize=np.where(space.periodic, 2.0 * np.pi, 0.0))


def _from_zero(configurations: NDArray[np.floating], space: JointSpace) -> NDArray[np.float64]:
    """Circles moved to [0, 2 pi), which is what a periodic tree takes."""
    shifted = np.asarray(configurations, dtype=np.float64)
    turned = np.mod(shifted, 2.0 * np.pi)
    # The modulo of a tiny negative number rounds up to the full period.
    turned = np.where(turned >= 2.0 * np.pi, 0.0, turned)
    return np.where(space.periodic, turned, shifted)
