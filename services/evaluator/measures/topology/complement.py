"""The complement of a point cloud in the joint space, approximated from the cloud alone.

Source: the paper's algorithm 1 (Generation of X^c from X).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.space import JointSpace

POINTS_PER_CELL = 4.0


def occupancy(
    points: NDArray[np.floating[Any]], space: JointSpace, points_per_cell: float = POINTS_PER_CELL
) -> NDArray[np.int64]:
    """Points per cell of a regular grid inside the joint limits, (B, ..., B) for d joints.

    The cells are sized so that one holds ``points_per_cell`` points on average if they were uniform.
    """
    bins = max(2, int((len(points) / points_per_cell) ** (1.0 / space.dim)))
    ranges = list(zip(space.lower, space.upper, strict=True))
    counts, _ = np.histogramdd(np.asarray(points, dtype=np.float64), bins=bins, range=ranges)
    return counts.astype(np.int64)


def boundary_cells(counts: NDArray[np.int64], periodic: tuple[bool, ...]) -> NDArray[np.bool_]:
    """Empty cells that touch another empty cell along some joint.

    A lone empty cell is taken for chance between the points. On a circle the last cell touches the first.
    """
    empty = counts == 0
    touched = np.zeros_like(empty)
    for axis, closed in enumerate(periodic):
        for step in (-1, 1):
            neighbour = np.roll(empty, step, axis=axis)
            if not closed:
                edge = np.moveaxis(neighbour, axis, 0)
                edge[0 if step == 1 else -1] = False
            touched |= neighbour
    return np.asarray(empty & touched)


def sample_complement(
    points: NDArray[np.floating[Any]],
    space: JointSpace,
    rng: np.random.Generator,
    count: int,
    points_per_cell: float = POINTS_PER_CELL,
) -> NDArray[np.float64]:
    """``count`` configurations from the regions that the points leave empty, weighted by area.

    Returns:
        (count, d) rad, or (0, d) when no region is empty.
    """
    cells = np.argwhere(boundary_cells(occupancy(points, space, points_per_cell), space.periodic))
    if len(cells) == 0:
        return np.empty((0, space.dim))
    bins = max(2, int((len(points) / points_per_cell) ** (1.0 / space.dim)))
    low, high = np.asarray(space.lower), np.asarray(space.upper)
    # All cells have the same area, so drawing them evenly weights every region by its own.
    corners = cells[rng.integers(0, len(cells), size=count)]
    return np.asarray(low + (corners + rng.random((count, space.dim))) * (high - low) / bins)
