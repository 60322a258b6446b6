"""Obstacles as rows of a data set's arrays, padded with NaN to a common count. Numpy alone."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.worlds.spatial.obstacles.shapes import Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Pose, make_pose, pose_of

# Place 3, rotation 9 (row by row), half sizes 3; of cylinders radius and half length 2.
BOX_VALUES, CYLINDER_VALUES = 15, 14
# Of one kind in a scene.
MOST = 192


def rows_of(obstacles: Obstacles) -> dict[str, NDArray[np.float64]]:
    """``boxes`` (192, 15) and ``cylinders`` (192, 14), in the order of the obstacles, NaN behind the last.

    Raises:
        ScenarioError: there are more.
    """
    arrays = obstacles.arrays
    return {
        "boxes": _padded(arrays.boxes[:, :BOX_VALUES]),
        "cylinders": _padded(arrays.cylinders[:, :CYLINDER_VALUES]),
    }


def obstacles_of(boxes: ArrayLike, cylinders: ArrayLike) -> Obstacles:
    """The inverse of :func:`rows_of`: (any, 15) and (any, 14)."""
    made: list[Box | Cylinder] = [
        Box(_pose(row), (float(row[12]), float(row[13]), float(row[14]))) for row in _held(boxes)
    ]
    made += [Cylinder(_pose(row), float(row[12]), float(row[13])) for row in _held(cylinders)]
    return Obstacles.of(made)


def _held(rows: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(rows, dtype=np.float64)
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _padded(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(rows) > MOST:
        raise ScenarioError(
            "the scene is too full for a data set", expected=f"at most {MOST}", got=str(len(rows))
        )
    return np.pad(rows, ((0, MOST - len(rows)), (0, 0)), constant_values=np.nan)


def _pose(row: NDArray[np.float64]) -> Pose:
    return pose_of(make_pose(row[3:12].reshape(3, 3), row[:3]))
