"""Obstacles in space: boxes and cylinders with a pose, as values and as arrays."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.files import Record, validated
from cspace.worlds.spatial.poses import MAX_PLACE_M, Pose, check_pose, make_pose, pose_of, vector

MAX_OBSTACLES = 1000
_Size = Annotated[float, Field(gt=0.0, le=MAX_PLACE_M, strict=True)]


@validated(ScenarioError)
class Box(Record):
    """A cuboid; ``pose`` is of its centre, rows of a 4 x 4 matrix in the base frame, m."""

    pose: Pose
    half_m: tuple[_Size, _Size, _Size]

    def __post_init__(self) -> None:
        check_pose(self.pose, "a box")


@validated(ScenarioError)
class Cylinder(Record):
    """A solid round cylinder."""

    pose: Pose  # of its centre, rows of a 4 x 4 matrix in the base frame, m; its axis is its own z
    radius_m: _Size
    half_length_m: _Size

    def __post_init__(self) -> None:
        check_pose(self.pose, "a cylinder")


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleArrays:
    """Obstacles as kernels take them, float64."""

    # (B, 16): centre 3, rotation 9 (row by row, its columns are the box's axes), half sizes 3, radius of the
    # sphere round it
    boxes: NDArray[np.float64]
    cylinders: NDArray[np.float64]  # (C, 15): centre, rotation, radius, half length, sphere's radius


@validated(ScenarioError)
class Obstacles(Record):
    """What stands in a scene; together at most 1000."""

    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()

    def __post_init__(self) -> None:
        if len(self) > MAX_OBSTACLES:
            raise ScenarioError(
                "the scene has too many obstacles", expected=f"at most {MAX_OBSTACLES}", got=str(len(self))
            )

    def __len__(self) -> int:
        return len(self.boxes) + len(self.cylinders)

    @property
    def shapes(self) -> tuple[Box | Cylinder, ...]:
        return (*self.boxes, *self.cylinders)

    @classmethod
    def of(cls, shapes: Iterable[Box | Cylinder]) -> "Obstacles":
        every = tuple(shapes)
        return cls(
            tuple(one for one in every if isinstance(one, Box)),
            tuple(one for one in every if isinstance(one, Cylinder)),
        )

    @property
    def arrays(self) -> ObstacleArrays:
        """For kernels; not to be written to."""
        return _arrays(self)


@lru_cache(maxsize=16)
def _arrays(obstacles: Obstacles) -> ObstacleArrays:
    boxes = [kernel_row(one.pose, one.half_m) for one in obstacles.boxes]
    cylinders = [kernel_row(one.pose, (one.radius_m, one.half_length_m)) for one in obstacles.cylinders]
    found = ObstacleArrays(
        np.array(boxes, dtype=np.float64).reshape(-1, 16),
        np.array(cylinders, dtype=np.float64).reshape(-1, 15),
    )
    found.boxes.setflags(write=False)
    found.cylinders.setflags(write=False)
    return found


def kernel_row(pose: ArrayLike, half_m: ArrayLike) -> NDArray[np.float64]:
    """A row of :class:`ObstacleArrays`: a shape by its pose (4, 4), half sizes or radius and half length."""
    matrix, sizes = np.asarray(pose, dtype=np.float64), np.asarray(half_m, dtype=np.float64)
    return np.concatenate([matrix[:3, 3], matrix[:3, :3].ravel(), sizes, [np.hypot.reduce(sizes)]])


# Place 3, rotation 9 (row by row), half sizes 3; of cylinders radius and half length 2.
BOX_VALUES, CYLINDER_VALUES = 15, 14
# Of one kind in a scene.
MOST = 192


def rows_of(obstacles: Obstacles) -> dict[str, NDArray[np.float64]]:
    """``boxes`` (192, 15) and ``cylinders`` (192, 14), in the order of the obstacles, NaN behind the last."""
    arrays = obstacles.arrays
    return {
        "boxes": _padded(arrays.boxes[:, :BOX_VALUES]),
        "cylinders": _padded(arrays.cylinders[:, :CYLINDER_VALUES]),
    }


def obstacles_of(boxes: ArrayLike, cylinders: ArrayLike) -> Obstacles:
    """The inverse of :func:`rows_of`: (any, 15) and (any, 14)."""
    made: list[Box | Cylinder] = [Box(_pose(row), vector(row[12:])) for row in _held(boxes)]
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
