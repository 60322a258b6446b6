"""Precision and recall of k-NN manifolds (Kynkaanniemi et al. 2019, equations 1 and 2) on the joint space.

The manifold of a group is the union of balls around its members, each as large as the distance to the
member's k-th nearest neighbour within the group.
"""

import numpy as np
from numpy.typing import NDArray

from cspace.space import JointSpace
from services.evaluator.metrics import Samples, metric
from services.evaluator.metrics.coverage import neighbour_tree

# A ball of 5 of 1000 uniform points on the torus of two joints has a radius of 0.25 rad, close to that of
# coverage. The source takes 3 of 50000; with so few points 3 leave holes between real samples themselves.
NEIGHBOURS = 5


@metric("knn_precision", logged=())
def knn_precision(group: Samples) -> float:
    """Share of samples inside the manifold of the held-out configurations."""
    return inside_manifold(group.samples, group.held_out, group.space)


@metric("knn_recall", logged=())
def knn_recall(group: Samples) -> float:
    """Share of held-out configurations inside the manifold of the samples."""
    return inside_manifold(group.held_out, group.samples, group.space)


def inside_manifold(
    points: NDArray[np.floating], members: NDArray[np.floating], space: JointSpace, k: int = NEIGHBOURS
) -> float:
    """Share of (N, d) points inside the manifold of (M, d) members, M above k."""
    tree, manifold = neighbour_tree(points, space), neighbour_tree(members, space)
    # Each member is its own nearest neighbour, at distance zero.
    radii, _ = manifold.query(manifold.data, [k + 1])
    inside = np.zeros(tree.n, dtype=np.bool_)
    for reached in tree.query_ball_point(manifold.data, radii[:, 0]):
        inside[reached] = True
    return float(inside.mean())
