"""From the square of two joints to an enlarged disk, so that the geometry score sees every hole.

Source: the paper's section on GS-C: elliptical map of the square to the disk, four quarter turns, and the
exponential, which stretches the first quadrant and with it the holes that a turn has brought there.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.space import JointSpace

QUARTER_TURNS = 4


def square_to_disk(square: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """The elliptical map from [-1, 1]^2 onto the unit disk, (N, 2) to (N, 2)."""
    x, y = square[:, 0], square[:, 1]
    return np.stack([x * np.sqrt(1.0 - y * y / 2.0), y * np.sqrt(1.0 - x * x / 2.0)], axis=1)


def quarter_turn(points: NDArray[np.float64], turns: int) -> NDArray[np.float64]:
    """(N, 2) rotated counter-clockwise by ``turns`` quarters of a circle, exactly."""
    x, y = points[:, 0], points[:, 1]
    return np.stack([(x, y), (-y, x), (-x, -y), (y, -x)][turns % QUARTER_TURNS], axis=1)


def enlarged_turns(
    configurations: NDArray[np.floating[Any]], space: JointSpace
) -> Iterator[NDArray[np.float64]]:
    """The four enlarged disks of (N, 2) configurations, each (N, 2).

    Raises:
        EvaluationError: the joint space has not two dimensions.
    """
    if space.dim != 2:
        raise EvaluationError(
            "the disk map is for two joints", expected="2", got=str(space.dim), remedy="use the plain score"
        )
    low, high = np.asarray(space.lower), np.asarray(space.upper)
    disk = square_to_disk(2.0 * (configurations - low) / (high - low) - 1.0)
    for turns in range(QUARTER_TURNS):
        yield np.exp(quarter_turn(disk, turns))
