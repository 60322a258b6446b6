"""Nearest-neighbour measures on the torus: coverage, and the precision and recall of k-NN manifolds.

Precision and recall are those of Kynkaanniemi et al., "Improved precision and recall metric for assessing
generative models" (NeurIPS 2019). Packages for them measure Euclidean distances, which tear a circle apart
at +-pi, so they are computed here.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cspace.errors import EvaluationError
from cspace.space import JointSpace

Configurations = NDArray[np.floating[Any]]

# A ball of 5 of 1000 uniform points on the torus of two joints has a radius of 0.25 rad, close to that of
# coverage. The source takes 3 of 50000; with so few points 3 leave holes between real samples themselves.
NEIGHBOURS = 5


@dataclass(frozen=True, slots=True)
class KnnQuality:
    """Precision and recall of k-NN manifolds, both in [0, 1].

    Args:
        precision: share of generated samples inside the real samples' manifold.
        recall: share of real samples inside the generated samples' manifold.
    """

    precision: float
    recall: float


def coverage(
    held_out: Configurations, samples: Configurations, space: JointSpace, radius_rad: float
) -> float:
    """Share of (M, d) held-out configurations with one of (N, d) samples within a radius, round the circles.

    Raises:
        EvaluationError: one of the two is empty.
    """
    return float(np.mean(covered(held_out, samples, space, radius_rad)))


def covered(
    held_out: Configurations, samples: Configurations, space: JointSpace, radius_rad: float
) -> NDArray[np.bool_]:
    """Which of (M, d) held-out configurations have one of (N, d) samples within a radius, (M,).

    Raises:
        EvaluationError: one of the two is empty.
    """
    require_group(held_out)
    nearest, _ = _tree(samples, space).query(_from_zero(held_out, space))
    return np.asarray(nearest <= radius_rad)


def knn_precision_recall(
    real: Configurations, generated: Configurations, space: JointSpace, k: int = NEIGHBOURS
) -> KnnQuality:
    """Precision and recall of Kynkaanniemi et al. 2019, equations 1 and 2, in the joint space's own metric.

    The manifold of a group is the union of balls round its members, each as large as the distance to the
    member's k-th nearest neighbour within the group, itself not counted.

    Args:
        real: (M, d) configurations of the true distribution, rad.
        generated: (N, d) configurations under test, rad.
        space: tells which joints are circles.
        k: neighbours that a ball reaches.

    Raises:
        EvaluationError: k below 1, or a group without k + 1 members.
    """
    if k < 1:
        raise EvaluationError("a ball needs a neighbour to reach", expected="k >= 1", got=str(k))
    require_group(real, generated, at_least=k + 1)
    trees = _tree(real, space), _tree(generated, space)
    return KnnQuality(
        float(np.mean(_within(trees[1], trees[0], k))), float(np.mean(_within(trees[0], trees[1], k)))
    )


def require_group(*groups: Configurations, at_least: int = 1) -> None:
    """Raise where a group is no (N, d) array of enough rows.

    Raises:
        EvaluationError: it is not.
    """
    for group in groups:
        if group.ndim != 2 or len(group) < at_least:
            raise EvaluationError(
                "the group of configurations is too small",
                expected=f"shape (N, d) with N >= {at_least}",
                got=f"shape {group.shape}",
            )


def _within(points: cKDTree, manifold: cKDTree, k: int) -> NDArray[np.bool_]:
    """Which points lie in a ball of the manifold, (n,)."""
    # Each member is its own nearest neighbour, at distance zero.
    distances, _ = manifold.query(manifold.data, [k + 1])
    inside = np.zeros(points.n, dtype=np.bool_)
    for reached in points.query_ball_point(manifold.data, distances[:, 0]):
        inside[reached] = True
    return inside


def _tree(configurations: Configurations, space: JointSpace) -> cKDTree:
    require_group(configurations)
    # A period of 0 tells the tree that a joint is no circle.
    return cKDTree(_from_zero(configurations, space), boxsize=np.where(space.periodic, 2.0 * np.pi, 0.0))


def _from_zero(configurations: Configurations, space: JointSpace) -> NDArray[np.float64]:
    """Circles moved to [0, 2 pi), which is what a periodic tree takes."""
    shifted = np.asarray(configurations, dtype=np.float64)
    turned = np.mod(shifted, 2.0 * np.pi)
    # The modulo of a tiny negative number rounds up to the full period.
    turned = np.where(turned >= 2.0 * np.pi, 0.0, turned)
    return np.where(space.periodic, turned, shifted)
